import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.geometry.camera import Camera, FloorView, image_from_floor, project, raw_from_ideal
from ebjax.geometry.homography import apply
from ebjax.geometry.lens import PINHOLE, lens
from ebjax.train.calibrate_camera import COEFFICIENTS, MOUNT, numbers_of, with_numbers
from ebjax.train.calibrate_floor import floor_distance_m, on_floor, raw_keypoints, rays_of_pixels
from ebjax.views.run_view import choose_floor, from_camera

K = np.array([[400.0, 0, 310.0], [0, 404.0, 245.0], [0, 0, 1]])
NUMBERS = np.array([np.radians(20), np.radians(1.0), np.radians(0.5), 0.55, 0.25, 0.05, 400.0, 310.0, 245.0])
LENSES = {
    "pinhole": PINHOLE,
    "plumb_bob": lens("plumb_bob", [-0.2, 0.05, 1e-3, -2e-3, 0.01]),
    "equidistant": lens("equidistant", [0.05, -0.02, 0.01, -0.004]),
}
FLOOR = np.random.default_rng(0).uniform([0.9, -0.7], [2.4, 0.7], (40, 2))


def camera_with(model):
    bent = LENSES[model]
    return with_numbers(Camera(K, np.eye(4), 640, 480, bent), np.append(NUMBERS, bent.coefficients))


@pytest.mark.slow
@pytest.mark.parametrize("model", LENSES)
def test_pixels_lead_back_to_their_floor(model):
    camera = camera_with(model)
    pixels = raw_from_ideal(camera, project(camera, np.pad(FLOOR, ((0, 0), (0, 1))))[0])
    slopes = jnp.broadcast_to(jnp.eye(2), (len(FLOOR), 2, 2))

    @jax.jit
    def floor(numbers, pixels):
        rays = rays_of_pixels(with_numbers(camera, numbers), pixels, slopes)
        return on_floor(numbers[MOUNT], rays.rays, rays.spreads)

    numbers = jnp.asarray(numbers_of(camera))
    points, spreads = floor(numbers, pixels)
    np.testing.assert_allclose(points, FLOOR, atol=1e-9)
    for k, step in enumerate(1e-4 * jnp.eye(2)):
        moved = (floor(numbers, pixels + step[None])[0] - floor(numbers, pixels - step[None])[0]) / 2e-4
        np.testing.assert_allclose(spreads[..., k], moved, rtol=1e-6, atol=1e-9)
    by_points, by_spreads = jax.jacfwd(floor)(numbers, pixels)
    for k, h in enumerate([1e-6] * 6 + [1e-4] * 3 + [1e-6] * (len(numbers) - COEFFICIENTS.start)):
        ahead, behind = (floor(numbers.at[k].add(e), pixels) for e in (h, -h))
        np.testing.assert_allclose(by_points[..., k], (ahead[0] - behind[0]) / (2 * h), rtol=1e-5, atol=1e-7)
        np.testing.assert_allclose(by_spreads[..., k], (ahead[1] - behind[1]) / (2 * h), rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("model", ["pinhole", "equidistant"])
def test_keypoints_of_the_view_are_raw_pixels(model):
    camera = camera_with(model)
    view = from_camera(camera, FloorView(0.9, 2.3, -0.7, 0.7, 0.01))
    keypoints = np.random.default_rng(1).uniform(20, 120, (30, 2))
    pixels, slopes = raw_keypoints(view, camera, jnp.asarray(keypoints), 0.25)

    def raw(keypoints):
        return raw_from_ideal(camera, apply(image_from_floor(camera), apply(view.floor_from_view, keypoints)))

    np.testing.assert_allclose(pixels, raw(jnp.asarray(keypoints)), atol=1e-9)
    for k, step in enumerate(1e-4 * np.eye(2)):
        ahead, behind = (raw(jnp.asarray(keypoints + e * step)) for e in (1, -1))
        np.testing.assert_allclose(slopes[..., k], 0.25 * (ahead - behind) / 2e-4, rtol=1e-5, atol=1e-8)


def test_distance_of_the_floors_of_two_heights():
    camera = camera_with("plumb_bob")
    low = numbers_of(camera)
    view = from_camera(camera, choose_floor(camera, 0.02))
    rows, columns = np.nonzero(np.asarray(view.seen))
    seen = apply(view.floor_from_view, np.stack([columns, rows], 1).astype(float))
    from_foot = np.linalg.norm(seen - low[None, 4:6], axis=1).mean()
    for share in (0.0, 0.01, -0.03):  # everything is farther from the camera's foot by that share
        high = np.where(np.arange(len(low)) == 3, (1 + share) * low, low)
        assert floor_distance_m(low, high, camera, 0.02) == pytest.approx(abs(share) * from_foot, abs=1e-9)


def test_a_pixel_outside_the_lens_has_no_ray():
    folding = lens("plumb_bob", [-0.6, 0.0, 0.0, 0.0])
    camera = with_numbers(Camera(K, np.eye(4), 640, 480, folding), np.append(NUMBERS, folding.coefficients))
    pixels = jnp.array([[310.0, 245.0], [0.0, 0.0]])
    rays = rays_of_pixels(camera, pixels, jnp.broadcast_to(jnp.eye(2), (2, 2, 2)))
    assert rays.there.tolist() == [True, False]
    assert np.isfinite(rays.rays).all() and np.isfinite(rays.spreads).all()
