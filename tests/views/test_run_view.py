import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.geometry.camera import Camera, FloorView, camera_over_floor
from ebjax.geometry.homography import apply
from ebjax.views.floor_view import floor_view, view_taps
from ebjax.views.run_view import choose_floor, from_camera, from_quad


def camera(height_m=0.54, pitch_deg=19.0, focal=615.0, width=640, height=480):
    return camera_over_floor(
        focal, focal, width / 2, height / 2, width, height, height_m, np.radians(pitch_deg), x_m=0.27
    )


@pytest.mark.parametrize(
    "setup",
    [
        {},
        {"height_m": 1.2, "pitch_deg": 35.0, "focal": 382.0},
        {"height_m": 0.2, "pitch_deg": 5.0},
        {"focal": 1500.0, "width": 1920, "height": 1080, "height_m": 1.4, "pitch_deg": 30.0},
        {"focal": 150.0, "width": 160, "height": 120},
    ],
)
def test_the_chosen_floor_is_seen(setup):
    chosen = choose_floor(camera(**setup), 0.01)
    view = from_camera(camera(**setup), chosen)
    assert 0.4 <= chosen.x_max - chosen.x_min <= 2.01
    middle = np.asarray(view.seen)[:, view.size[1] // 2]
    assert middle.mean() > 0.98
    assert np.asarray(view.seen).mean() > 0.3
    np.testing.assert_allclose(view.centre_m, [(chosen.x_min + chosen.x_max) / 2, 0.0], atol=0.006)


@pytest.mark.parametrize("setup", [{"pitch_deg": -40.0}, {"height_m": -0.5}, {"height_m": 0.005, "pitch_deg": 0.0}])
def test_a_camera_that_sees_no_floor_is_refused(setup):
    with pytest.raises(ValueError, match="T_base_camera"):
        choose_floor(camera(**setup), 0.01)


@pytest.mark.parametrize("quarters", [1, 2, 3])
@pytest.mark.parametrize("setup", [{}, {"height_m": 1.2, "pitch_deg": 35.0, "focal": 382.0}])
def test_a_camera_on_its_side_or_head_sees_the_same_floor(setup, quarters):
    upright = camera(**setup)
    rgb = np.random.default_rng(0).integers(0, 255, (480, 640, 3), dtype=np.uint8)
    intrinsics, pose, size = np.asarray(upright.intrinsics), np.asarray(upright.base_from_camera), (640, 480)
    for _ in range(quarters):  # as np.rot90 turns pixels: (x, y) -> (y, width - 1 - x)
        rgb = np.rot90(rgb).copy()
        fx, fy, cx, cy = intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2], intrinsics[1, 2]
        intrinsics = np.array([[fy, 0, cy], [0, fx, size[0] - 1 - cx], [0, 0, 1]])
        turn = np.eye(4)
        turn[:2, :2] = [[0, -1], [1, 0]]
        pose, size = pose @ turn, size[::-1]
    turned = Camera(jnp.asarray(intrinsics), jnp.asarray(pose), *size)
    chosen = choose_floor(upright, 0.01)
    assert choose_floor(turned, 0.01) == chosen
    views = [
        floor_view(jnp.asarray(picture), view_taps(from_camera(one, chosen), one))
        for picture, one in ((np.rot90(rgb, -quarters).copy(), upright), (rgb, turned))
    ]
    np.testing.assert_allclose(views[0], views[1], atol=0.02)


def test_a_quad_of_a_metric_rectangle_is_the_metric_view():
    floor = FloorView(1.2, 2.0, -0.4, 0.4, 0.004)
    metric = from_camera(camera(), floor)
    corners = jnp.array([[0.0, 0.0], [199.0, 0.0], [199.0, 199.0], [0.0, 199.0]])
    view = from_quad(camera(), np.asarray(apply(metric.image_from_view, corners)), 0.0)
    grid = jnp.array([[3.0, 5.0], [100.0, 20.0], [199.0, 199.0]])
    np.testing.assert_allclose(apply(view.image_from_view, grid), apply(metric.image_from_view, grid), atol=1e-6)
    np.testing.assert_allclose(apply(view.floor_from_view, grid), apply(metric.floor_from_view, grid), atol=1e-9)


def test_the_margin_lies_around_the_quad():
    quad = np.array([[180, 250], [460, 250], [600, 440], [40, 440]], float)
    view = from_quad(camera(), quad, 0.5)
    inner = np.array([[0.25, 0.25], [0.75, 0.25], [0.75, 0.75], [0.25, 0.75]]) * 199
    np.testing.assert_allclose(apply(view.image_from_view, jnp.asarray(inner)), quad, atol=1e-6)
