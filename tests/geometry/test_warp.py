"""Warping against SciPy and OpenCV, its inverse, its gradients, and the turn by pi."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from ebjax.geometry import camera, homography, warp

QUAD = np.array([[18.3, 30.1], [46.2, 29.4], [58.1, 44.7], [7.6, 46.2]])
SQUARE = np.array([[0.0, 0], [39, 0], [39, 39], [0, 39]])
SOURCE_FROM_TARGET = np.array(homography.from_four_points(SQUARE, QUAD))


@pytest.fixture
def image():
    noise = np.random.default_rng(0).uniform(size=(48, 64, 3))
    smooth = gaussian_filter(noise, (1.5, 1.5, 0))
    return (smooth - smooth.min()) / (smooth.max() - smooth.min())


def grid(size):
    rows, cols = np.mgrid[: size[0], : size[1]]
    return np.stack([cols, rows], axis=-1).astype(float)


def test_sampling_equals_scipy_inside_and_across_the_border(image):
    points = np.random.default_rng(1).uniform(-3, 66, (300, 2))
    expected = [map_coordinates(image[..., c], points.T[::-1], order=1, mode="grid-constant") for c in range(3)]
    np.testing.assert_allclose(warp.sample_bilinear(image, points), np.stack(expected, axis=1), atol=1e-12)


def test_warp_equals_opencv(image):
    points = np.array(homography.apply(SOURCE_FROM_TARGET, grid((40, 40)).reshape(-1, 2)), np.float32)
    x, y = points.reshape(40, 40, 2).transpose(2, 0, 1)
    expected = cv2.remap(image.astype(np.float32), x.copy(), y.copy(), cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    ours = warp.warp(image.astype(np.float32), SOURCE_FROM_TARGET, (40, 40))
    np.testing.assert_allclose(ours, expected, atol=0.02)  # OpenCV rounds positions to 1/32 px


def test_warp_then_unwarp(image):
    smooth = gaussian_filter(image, (3, 3, 0))
    a = 0.3
    turn = np.array([[np.cos(a), -np.sin(a), 12.0], [np.sin(a), np.cos(a), -3.0], [1e-4, -2e-4, 1.0]])
    back = warp.warp(warp.warp(smooth, turn, (96, 96)), np.linalg.inv(turn), (48, 64))
    np.testing.assert_allclose(back[15:33, 20:44], smooth[15:33, 20:44], atol=0.01)


def test_identity_and_whole_pixel_shifts_are_exact(image):
    np.testing.assert_array_equal(warp.warp(image, np.eye(3), (48, 64)), image)
    shift = np.array([[1.0, 0, 5], [0, 1, 2], [0, 0, 1]])
    np.testing.assert_array_equal(warp.warp(image, shift, (46, 59)), image[2:, 5:])


def test_rotate_pi_is_the_warp_by_its_matrix_and_its_own_inverse(image):
    turned = warp.rotate_pi(image)
    np.testing.assert_allclose(turned, warp.warp(image, homography.rotate_pi_matrix(64, 48), (48, 64)), atol=1e-12)
    np.testing.assert_array_equal(warp.rotate_pi(turned), image)
    np.testing.assert_allclose(
        warp.flip_lr(image), warp.warp(image, homography.flip_lr_matrix(64, 48), (48, 64)), atol=1e-12
    )
    np.testing.assert_array_equal(warp.rotate_pi(image[None])[0], turned)


def test_opposing_cameras_agree_after_the_turn(image):
    """Two robots face each other; each one's view of the same square metre is the other's, turned by pi."""
    view = camera.FloorView(0.7, 1.7, -0.5, 0.5, 0.02)
    floor_px_from_floor = np.array([[20.0, 0, 10], [0, 18, 22], [0, 0, 1]])
    there = np.array([[-1.0, 0, 2.4], [0, -1, 0], [0, 0, 1]])
    ours = warp.warp(image, floor_px_from_floor @ view.floor_from_view, view.size)
    theirs = warp.warp(image, floor_px_from_floor @ there @ view.floor_from_view, view.size)
    np.testing.assert_allclose(warp.rotate_pi(theirs), ours, atol=1e-9)
    assert np.abs(np.array(theirs) - np.array(ours)).mean() > 0.05


def test_bytes_equal_floats(image):
    raw = np.round(image * 255).astype(np.uint8)
    ours = warp.warp(raw, SOURCE_FROM_TARGET.astype(np.float32), (40, 40))
    assert ours.dtype == jnp.float32
    expected = warp.warp(raw.astype(np.float32) / 255, SOURCE_FROM_TARGET.astype(np.float32), (40, 40))
    np.testing.assert_allclose(ours, expected, atol=1e-6)


def test_taps_once_serve_images_and_batches(image):
    images = np.stack([image, image[::-1]])
    taps = warp.taps(warp.grid_points(SOURCE_FROM_TARGET, (40, 40)), (48, 64))
    single = np.stack([warp.warp(i, SOURCE_FROM_TARGET, (40, 40)) for i in images])
    np.testing.assert_allclose(np.stack([warp.gather(i, taps) for i in images]), single, atol=1e-12)
    np.testing.assert_allclose(warp.gather_batch(images, taps), single, atol=1e-12)
    np.testing.assert_allclose(warp.warp_batch(images, SOURCE_FROM_TARGET, (40, 40)), single, atol=1e-12)
    several = jax.jit(jax.vmap(lambda i, h: warp.warp(i, h, (40, 40))))(images, jnp.stack([SOURCE_FROM_TARGET] * 2))
    np.testing.assert_allclose(several, single, atol=1e-12)


def test_gradient_of_a_patch_in_the_homography(image):
    target = np.random.default_rng(2).uniform(size=(16, 16, 3))

    def loss(h):
        return jnp.mean((warp.warp(image, h, (16, 16)) - target) ** 2)

    at = jnp.asarray(SOURCE_FROM_TARGET)
    ours = np.array(jax.grad(loss)(at))
    step = np.array([[1e-7] * 2 + [1e-6], [1e-7] * 2 + [1e-6], [1e-9] * 2 + [1e-7]])
    for i, j in np.ndindex(3, 3):
        numeric = (loss(at.at[i, j].add(step[i, j])) - loss(at.at[i, j].add(-step[i, j]))) / (2 * step[i, j])
        np.testing.assert_allclose(ours[i, j], numeric, rtol=1e-5)


def test_gradient_in_points_and_image(image):
    rng = np.random.default_rng(3)
    inputs = (jnp.asarray(image), jnp.asarray(rng.uniform(-1, 60, (20, 2))))
    weights = jnp.asarray(rng.normal(size=(20, 3)))

    def value(*x):
        return jnp.sum(warp.sample_bilinear(*x) * weights)

    directions = tuple(jnp.asarray(rng.normal(size=x.shape)) for x in inputs)
    _, slope = jax.jvp(value, inputs, directions)
    ahead, behind = (value(*(x + e * d for x, d in zip(inputs, directions, strict=True))) for e in (1e-6, -1e-6))
    np.testing.assert_allclose(slope, (ahead - behind) / 2e-6, rtol=1e-5)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_values_and_gradients_are_finite_at_and_beyond_the_horizon(image, dtype):
    horizon = jnp.array([[1.0, 0, 0], [0, 1, 0], [0, -1 / 16, 1]], dtype)
    picture = jnp.asarray(image, dtype)
    value, gradient = jax.value_and_grad(lambda h: jnp.sum(warp.warp(picture, h, (40, 40)) ** 2))(horizon)
    assert jnp.isfinite(value) and jnp.all(jnp.isfinite(gradient)) and gradient.dtype == dtype
    far = jnp.array([[1e30, -1e30], [jnp.inf, 3.0]], dtype)
    sampled, gradient = jax.value_and_grad(lambda p: jnp.sum(warp.sample_bilinear(picture, p)))(far)
    assert sampled == 0 and not gradient.any()


@pytest.mark.slow
def test_float32_stays_float32(image):
    picture = jnp.asarray(image, jnp.float32)
    for h in (SOURCE_FROM_TARGET, SOURCE_FROM_TARGET.astype(np.float32)):
        assert warp.warp(picture, h, (8, 8)).dtype == jnp.float32
    assert warp.warp(jnp.asarray(image), SOURCE_FROM_TARGET, (8, 8)).dtype == jnp.float64
    assert warp.sample_bilinear(picture, np.zeros((2, 5, 2), np.float32)).shape == (2, 5, 3)
