"""RANSAC finds planted motions, agrees with OpenCV, and is harmless when there is nothing to find."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.geometry import homography, ransac

CORNERS = np.array([[0.0, 0], [399, 0], [399, 399], [0, 399]])
MODELS = ["rigid", "similarity", "homography"]


def planted(model, n=200, share=0.5, noise=0.5, seed=0):
    """Pairs of which a share agrees with one motion, px; the rest is uniform."""
    rng = np.random.default_rng(seed)
    a, scale = rng.uniform(-np.pi, np.pi), 1.0 if model == "rigid" else 1.3
    h = np.array([[scale * np.cos(a), -scale * np.sin(a), 40], [scale * np.sin(a), scale * np.cos(a), -20], [0, 0, 1]])
    if model == "homography":
        h[2, :2] = 5e-4, -4e-4
    source = rng.uniform(0, 400, (n, 2))
    target = np.array(homography.apply(h, source)) + rng.normal(0, noise, (n, 2))
    inliers = np.arange(n) < share * n
    target[~inliers] = rng.uniform(0, 400, ((~inliers).sum(), 2))
    return source, target, inliers, h


def corner_error(found, h):
    return np.abs(np.array(homography.apply(found, CORNERS)) - np.array(homography.apply(h, CORNERS))).max()


@pytest.mark.parametrize("model", MODELS)
def test_a_planted_motion_is_found(model):
    for seed in range(5):
        source, target, inliers, h = planted(model, seed=seed)
        found = ransac.estimate(
            source, target, np.ones(200, bool), key=jax.random.key(seed), model=model, tolerance=2.5
        )
        assert corner_error(found.homography, h) < 2
        assert np.mean(np.array(found.inliers) == inliers) > 0.97
        assert found.count == found.inliers.sum()


def test_rigid_is_found_among_four_fifths_outliers():
    for seed in range(10):
        source, target, _, h = planted("rigid", n=500, share=0.2, noise=1.0, seed=seed)
        found = ransac.estimate(
            source, target, np.ones(500, bool), key=jax.random.key(seed), model="rigid", hypotheses=1024, tolerance=4.0
        )
        assert corner_error(found.homography, h) < 3


def test_homography_is_as_good_as_opencv():
    source, target, inliers, _ = planted("homography", noise=1.0)
    expected, _ = cv2.findHomography(source, target, cv2.RANSAC, 3.0)
    found = ransac.estimate(
        source, target, np.ones(200, bool), key=jax.random.key(0), model="homography", tolerance=3.0
    )

    def rms(m):
        return np.sqrt(np.mean((np.array(homography.apply(m, source)) - target)[inliers] ** 2))

    assert rms(found.homography) < 1.02 * rms(expected)


def test_rows_that_are_not_valid_may_hold_anything():
    source, target, _, h = planted("rigid")
    valid = np.arange(200) < 120
    source[~valid], target[~valid] = np.nan, np.inf
    found = ransac.estimate(source, target, valid, key=jax.random.key(0), model="rigid", tolerance=2.5)
    assert corner_error(found.homography, h) < 2
    assert not found.inliers[~valid].any()


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("count", [0, 1])
def test_too_few_points_give_the_identity(model, count):
    source, target, _, _ = planted(model)
    found = ransac.estimate(source, target, np.arange(200) < count, key=jax.random.key(0), model=model, tolerance=2.5)
    np.testing.assert_array_equal(found.homography, np.eye(3))
    assert found.count == 0 and not found.inliers.any()


@pytest.mark.parametrize("model", MODELS)
def test_degenerate_points_are_harmless(model):
    line = np.stack([np.arange(50.0), 2 * np.arange(50.0)], axis=1)
    for source in (np.zeros((50, 2)), line):
        found = ransac.estimate(source, line, np.ones(50, bool), key=jax.random.key(0), model=model, tolerance=1.0)
        assert jnp.all(jnp.isfinite(found.homography)) and found.count == found.inliers.sum()


def test_rigid_refuses_a_mirror_image():
    source, _, _, _ = planted("rigid")
    mirrored = source * np.array([[-1.0, 1.0]])
    found = ransac.estimate(source, mirrored, np.ones(200, bool), key=jax.random.key(0), model="rigid", tolerance=2.5)
    assert found.count < 20 and np.linalg.det(found.homography) > 0


def test_points_beyond_the_horizon_are_no_inliers():
    h = np.array([[1.0, 0, 0], [0, 1, 0], [0, -1 / 200, 1]])
    source = np.random.default_rng(0).uniform([0, 0], [400, 400], (300, 2))
    source = source[np.abs(source[:, 1] - 200) > 20]
    source = source[np.argsort(source[:, 1])][:200]  # mostly above the horizon y = 200
    target = np.array(homography.apply(h, source))
    everything = np.ones(200, bool)
    found = ransac.estimate(source, target, everything, key=jax.random.key(1), model="homography", tolerance=1.0)
    above = source[:, 1] < 200
    np.testing.assert_array_equal(found.inliers, above)
    assert np.all(homography.denominator(found.homography, source[above]) > 0)


def test_sets_are_drawn_without_replacement_and_evenly():
    valid = np.zeros(30, bool)
    valid[3:30:3] = True
    sets = np.array(jax.jit(ransac.draw_sets, static_argnums=(2, 3))(valid, jax.random.key(0), 3000, 4))
    assert valid[sets].all()
    assert all(len(set(row)) == 4 for row in sets)
    counts = np.bincount(sets.ravel(), minlength=30)[valid]
    assert counts.min() > 0.9 * counts.mean() and counts.max() < 1.1 * counts.mean()


@pytest.mark.slow
def test_a_batch_equals_one_by_one_and_float32_stays():
    pairs = [planted("similarity", seed=s) for s in range(3)]
    source, target = (jnp.asarray(np.stack([p[k] for p in pairs]), jnp.float32) for k in (0, 1))
    keys = jax.random.split(jax.random.key(0), 3)

    def one(s, t, key):
        return ransac.estimate(s, t, jnp.ones(200, bool), key=key, model="similarity", tolerance=2.5)

    batch = jax.vmap(one)(source, target, keys)
    assert batch.homography.dtype == jnp.float32 and batch.count.shape == (3,)
    single = one(source[1], target[1], keys[1])
    np.testing.assert_allclose(batch.homography[1], single.homography, rtol=1e-4, atol=1e-3)
