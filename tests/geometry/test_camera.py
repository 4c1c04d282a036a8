"""The camera over the floor against a recorded one and OpenCV, and the floor view's grid."""

import json

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.geometry import camera as cameras
from ebjax.geometry import homography

VIEW = cameras.FloorView(0.5, 2.5, -1.0, 1.0, 0.01)


def over_floor(height_m=0.54, pitch=np.pi * 19 / 180, roll=0.0):
    return cameras.camera_over_floor(615, 610, 320, 240, 640, 480, height_m, pitch, roll, 0.27)


def test_camera_equals_the_recorded_mount(data):
    recorded = json.loads((data("corridor_rgbd") / "camera.json").read_text())
    np.testing.assert_allclose(over_floor().base_from_camera, recorded["T_base_camera"], atol=1e-3)


@pytest.mark.parametrize("roll", [0.0, 0.2])
def test_the_mount_is_a_rotation(roll):
    rotation = np.array(over_floor(roll=roll).base_from_camera)[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)


def test_roll_turns_the_camera_clockwise():
    base_from_camera = np.array(over_floor(pitch=0.0, roll=0.1).base_from_camera)
    assert base_from_camera[2, 0] < 0  # the camera's right side dips


def test_project_equals_opencv():
    camera = over_floor(roll=0.1)
    points = np.random.default_rng(0).uniform([1, -1, -0.2], [4, 1, 1], (50, 3))
    camera_from_base = np.linalg.inv(camera.base_from_camera)
    rotation, _ = cv2.Rodrigues(camera_from_base[:3, :3])
    expected, _ = cv2.projectPoints(points, rotation, camera_from_base[:3, 3], np.array(camera.intrinsics), None)
    pixels, depth = cameras.project(camera, points)
    np.testing.assert_allclose(pixels, expected[:, 0], atol=1e-8)
    lifted = cameras.backproject(pixels, depth, camera.intrinsics)
    pose = np.array(camera.base_from_camera)
    np.testing.assert_allclose(lifted @ pose[:3, :3].T + pose[None, :3, 3], points, atol=1e-9)


def test_rows_without_depth_are_zero():
    depth = np.array([1.0, 0.0, -1.0, np.nan, np.inf])
    points = np.array(cameras.backproject(np.ones((5, 2)), depth, over_floor().intrinsics))
    assert points[0, 2] == 1 and not points[1:].any()


def test_the_homography_agrees_with_projecting_the_floor():
    camera = over_floor(roll=-0.1)
    floor = np.random.default_rng(1).uniform([1, -1], [4, 1], (30, 2))
    pixels, depth = cameras.project(camera, np.concatenate([floor, np.zeros((30, 1))], axis=1))
    h = cameras.image_from_floor(camera)
    np.testing.assert_allclose(homography.apply(h, floor), pixels, atol=1e-8)
    np.testing.assert_allclose(homography.denominator(h, floor), depth, atol=1e-10)


def test_forward_is_up_and_left_is_left_in_the_floor_view():
    assert VIEW.size == (200, 200)
    corners = homography.apply(VIEW.floor_from_view, np.array([[-0.5, -0.5], [199.5, 199.5]]))
    np.testing.assert_allclose(corners, [[VIEW.x_max, VIEW.y_max], [VIEW.x_min, VIEW.y_min]], atol=1e-12)


def test_a_view_without_area_is_refused():
    with pytest.raises(ValueError, match="x_min < x_max"):
        cameras.FloorView(2.0, 1.0, -1.0, 1.0, 0.01)


def test_field_of_view_is_what_projects_into_the_image():
    view = cameras.FloorView(-2.0, 4.0, -2.0, 2.0, 0.02)
    camera = over_floor()
    rows, cols = np.mgrid[: view.height, : view.width]
    floor = homography.apply(view.floor_from_view, np.stack([cols.ravel(), rows.ravel()], axis=1).astype(float))
    pixels, depth = cameras.project(camera, np.concatenate([floor, np.zeros((len(floor), 1))], axis=1))
    x, y = np.array(pixels).T
    expected = (np.array(depth) > 0) & (x >= 4) & (x <= 635) & (y >= 4) & (y <= 475)
    seen = cameras.field_of_view(camera, cameras.image_from_view(camera, view), view.size, 4)
    np.testing.assert_array_equal(np.array(seen).ravel(), expected)
    assert 0 < expected.mean() < 1


def test_gradient_in_height_pitch_and_roll():
    @jax.jit
    def value(x):
        return jnp.sum(
            homography.apply(cameras.image_from_view(over_floor(*x), VIEW), jnp.array([[20.0, 30], [150, 90]]))
        )

    at = jnp.array([0.54, 0.33, 0.05])
    numeric = [(value(at.at[k].add(1e-6)) - value(at.at[k].add(-1e-6))) / 2e-6 for k in range(3)]
    np.testing.assert_allclose(jax.grad(value)(at), numeric, rtol=1e-6)


def test_a_batch_of_cameras_and_float32():
    heights = jnp.array([0.5, 0.6], jnp.float32)
    batch = jax.vmap(lambda h: cameras.camera_over_floor(615, 615, 320, 240, 640, 480, h, 0.3))(heights)
    h = jax.jit(jax.vmap(cameras.image_from_view, in_axes=(0, None)))(batch, VIEW)
    assert h.shape == (2, 3, 3) and h.dtype == jnp.float32
