from functools import partial

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from ebjax.models.rootsift import describe, pool_orientations, root_normalise, rotate_pi_descriptor

SIZE = (61, 83)


@partial(jax.jit, static_argnames="bin_px")
def described(grey, seen, at, bin_px=6.0):
    return describe(pool_orientations(grey, seen, bin_px), at)


def texture(size=SIZE, seed=0, sigma=2.0, dtype=np.float64):
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal(size), sigma)
    return jnp.asarray((noise - noise.min()) / np.ptp(noise), dtype)


def points(count=25, seed=1, margin=0.0):
    low, high = margin, np.array(SIZE[::-1]) - 1 - margin
    return jnp.asarray(np.random.default_rng(seed).uniform(low, high, (count, 2)))


@pytest.mark.parametrize("bin_px", [3.0, 6.0, 8.0])
def test_turned_image_has_the_turned_descriptors(bin_px):
    # Sizes of which (n - 1) is a multiple of the stride keep the pooling grid in place under R_pi.
    stride = bin_px / 3
    size = (int(stride * 30) + 1, int(stride * 40) + 1)
    grey, seen = texture(size), np.ones(size)
    seen[:, :9] = 0
    at = jnp.asarray(np.random.default_rng(1).uniform(0, np.array(size[::-1]) - 1, (40, 2)))
    turned = jnp.array([size[1] - 1.0, size[0] - 1.0])[None, :] - at
    straight, share = described(grey, jnp.asarray(seen), at, bin_px)
    other, other_share = described(grey[::-1, ::-1], jnp.asarray(seen[::-1, ::-1]), turned, bin_px)
    np.testing.assert_allclose(other, rotate_pi_descriptor(straight), atol=1e-5)
    np.testing.assert_allclose(other_share, share, atol=1e-9)


def test_turning_twice_is_nothing():
    descriptors = jnp.asarray(np.random.default_rng(0).random((3, 5, 128)))
    np.testing.assert_array_equal(rotate_pi_descriptor(rotate_pi_descriptor(descriptors)), descriptors)


def test_descriptors_are_unit_and_keep_the_dtype():
    for dtype in (np.float32, np.float64):
        descriptors, share = described(texture(dtype=dtype), jnp.ones(SIZE, dtype), points(margin=15).astype(dtype))
        assert descriptors.dtype == share.dtype == dtype
        np.testing.assert_allclose(np.linalg.norm(descriptors, axis=1), 1, atol=1e-3)
        np.testing.assert_allclose(share, 1, atol=0.05)


def test_contrast_and_brightness_do_not_matter():
    at = points(margin=15)
    one, _ = described(texture(), jnp.ones(SIZE), at)
    other, _ = described(0.3 * texture() + 0.5, jnp.ones(SIZE), at)
    np.testing.assert_allclose(one, other, atol=1e-4)


def test_what_is_not_seen_does_not_matter():
    seen = np.ones(SIZE)
    seen[:, 50:] = 0
    other = np.array(texture())
    other[:, 50:] = np.random.default_rng(5).random((SIZE[0], SIZE[1] - 50))
    at = points()
    one, share = described(texture(), jnp.asarray(seen), at)
    two, _ = described(jnp.asarray(other), jnp.asarray(seen), at)
    np.testing.assert_allclose(one, two, atol=1e-9)
    far = np.asarray(at)[:, 0] > 50 + 2 * 6 + 6
    assert far.any() and np.all(np.asarray(share)[far] == 0) and np.all(np.abs(np.asarray(one)[far]) < 1e-3)


def test_gradients_are_finite_and_match_central_differences():
    at, weights = points(6, margin=12), jnp.asarray(np.random.default_rng(3).standard_normal((6, 128)))

    def value(grey, where):
        return jnp.sum(weights * described(grey, jnp.ones(SIZE), where)[0])

    grey = texture()
    by_grey, by_points = jax.jit(jax.grad(value, argnums=(0, 1)))(grey, at)
    assert np.isfinite(by_grey).all() and np.isfinite(by_points).all()
    random = np.random.default_rng(4)
    for _ in range(3):
        step = jnp.asarray(gaussian_filter(random.standard_normal(SIZE), 1.0))
        numeric = (value(grey + 1e-6 * step, at) - value(grey - 1e-6 * step, at)) / 2e-6
        np.testing.assert_allclose(jnp.sum(by_grey * step), numeric, rtol=1e-4)
        shift = jnp.asarray(random.standard_normal(at.shape))
        numeric = (value(grey, at + 1e-6 * shift) - value(grey, at - 1e-6 * shift)) / 2e-6
        np.testing.assert_allclose(jnp.sum(by_points * shift), numeric, rtol=1e-5)


def test_flat_images_have_finite_gradients():
    gradient = jax.jit(jax.grad(lambda grey: described(grey, jnp.ones(SIZE), points())[0].sum()))
    assert np.isfinite(gradient(jnp.full(SIZE, 0.5))).all()
    assert np.isfinite(jax.grad(lambda h: root_normalise(h).sum())(jnp.zeros((2, 128)))).all()


def test_agrees_with_opencv_upright_sift():
    size, bin_px = (200, 240), 6.0
    grey = texture(size, sigma=3.0)
    at = np.random.default_rng(2).uniform(40, np.array(size[::-1]) - 40, (60, 2)).astype(np.float32)
    # OpenCV's spatial bin is 3 size / 2 px wide; angle 360 - 0 is upright.
    keypoints = [cv2.KeyPoint(float(x), float(y), 2 * bin_px / 3, 0.0) for x, y in at]
    image = np.rint(255 * np.asarray(grey)).astype(np.uint8)
    _, theirs = cv2.SIFT.create().compute(image, keypoints)
    # OpenCV counts orientations with y up.
    theirs = theirs.reshape(-1, 4, 4, 8)[..., -np.arange(8) % 8].reshape(-1, 128)
    theirs = root_normalise(jnp.asarray(theirs, jnp.float64))
    ours, _ = described(grey, jnp.ones(size), jnp.asarray(at, jnp.float64), bin_px)
    similarity = np.asarray(ours) @ np.asarray(theirs).T
    assert np.median(np.diag(similarity)) > 0.97
    assert np.min(np.diag(similarity)) > 0.9
    assert (similarity.argmax(1) == np.arange(len(at))).all()
