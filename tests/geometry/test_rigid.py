"""Kabsch against SciPy, similarities against Umeyama's property, ICP on a displaced cloud."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ebjax.geometry import rigid


def turn(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def noisy_pairs(dimension, n=30, noise=0.05, seed=0):
    rng = np.random.default_rng(seed)
    rotation = turn(2.5) if dimension == 2 else Rotation.from_rotvec([0.5, -2.0, 1.0]).as_matrix()
    source = rng.normal(size=(n, dimension))
    target = source @ rotation.T + np.arange(1.0, dimension + 1)[None] + rng.normal(0, noise, (n, dimension))
    return source, target, rng.uniform(0.1, 2, n)


@pytest.mark.parametrize("planar", [False, True])
def test_kabsch_3d_equals_scipy(planar):
    source, target, weights = noisy_pairs(3)
    if planar:
        source = source * np.array([[1.0, 1, 0]])
    share = weights / weights.sum()
    centred = target - share @ target, source - share @ source
    expected = Rotation.align_vectors(*centred, weights)[0].as_matrix()
    rotation, translation = rigid.kabsch(source, target, weights)
    np.testing.assert_allclose(rotation, expected, atol=1e-7)
    np.testing.assert_allclose(translation, share @ target - expected @ (share @ source), atol=1e-6)


def test_kabsch_2d_equals_3d_in_the_plane():
    source, target, weights = noisy_pairs(2)
    zeros = np.zeros((len(source), 1))
    rotation, translation = rigid.kabsch(source, target, weights)
    solid, shift = rigid.kabsch(np.hstack([source, zeros]), np.hstack([target, zeros]), weights)
    np.testing.assert_allclose(solid[:2, :2], rotation, atol=1e-10)
    np.testing.assert_allclose(shift[:2], translation, atol=1e-10)


@pytest.mark.parametrize("dimension", [2, 3])
def test_kabsch_never_reflects(dimension):
    source, _, weights = noisy_pairs(dimension)
    mirror = np.diag([-1.0] + [1.0] * (dimension - 1))
    rotation, _ = rigid.kabsch(source, source @ mirror, weights)
    assert np.linalg.det(rotation) == pytest.approx(1)


@pytest.mark.parametrize("dimension", [2, 3])
def test_kabsch_without_points_is_the_identity(dimension):
    source, target, weights = noisy_pairs(dimension)
    rotation, translation = rigid.kabsch(source, target, 0 * weights)
    np.testing.assert_array_equal(rotation, np.eye(dimension))
    np.testing.assert_array_equal(translation, 0)
    one = np.zeros(len(weights))
    one[3] = 1
    rotation, translation = rigid.kabsch(source, target, one)
    np.testing.assert_allclose(rotation @ source[3] + translation, target[3], atol=1e-12)


@pytest.mark.parametrize("dimension", [2, 3])
def test_kabsch_gradient_against_central_differences(dimension):
    inputs = tuple(jnp.asarray(x) for x in noisy_pairs(dimension))
    rng = np.random.default_rng(4)
    a, b = jnp.asarray(rng.normal(size=(dimension, dimension))), jnp.asarray(rng.normal(size=dimension))

    def value(*x):
        rotation, translation = rigid.kabsch(*x)
        return jnp.sum(rotation * a) + translation @ b

    directions = tuple(jnp.asarray(rng.normal(size=x.shape)) for x in inputs)
    _, slope = jax.jvp(value, inputs, directions)
    ahead, behind = (value(*(x + e * d for x, d in zip(inputs, directions, strict=True))) for e in (1e-6, -1e-6))
    np.testing.assert_allclose(slope, (ahead - behind) / 2e-6, rtol=1e-5)


@pytest.mark.parametrize(
    "corners", [[[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[1, 1, 0], [1, -1, 0], [-1, -1, 0], [-1, 1, 0]]]
)
def test_kabsch_gradient_of_symmetric_points_is_finite(corners):
    source = jnp.asarray(corners, jnp.float64)
    gradient = jax.grad(lambda p: rigid.kabsch(p, source, jnp.ones(len(source)))[0][0, 1])(source)
    assert np.isfinite(gradient).all() and gradient.any()


def test_similarity_recovers_scale_and_is_stationary():
    source, _, weights = noisy_pairs(2)
    exact = 1.7 * source @ turn(2.5).T + np.array([[3.0, -1.0]])
    h = np.array(rigid.fit_similarity(source, exact, weights))
    np.testing.assert_allclose(h[:2, :2], 1.7 * turn(2.5), atol=1e-12)
    noisy = exact + np.random.default_rng(1).normal(0, 0.1, exact.shape)
    h = rigid.fit_similarity(source, noisy, weights)

    def loss(x):
        linear = jnp.stack([jnp.stack([x[0], -x[1]]), jnp.stack([x[1], x[0]])])
        return jnp.sum(weights[:, None] * (source @ linear.T + x[None, 2:] - noisy) ** 2)

    at = jnp.stack([h[0, 0], h[1, 0], h[0, 2], h[1, 2]])
    np.testing.assert_allclose(jax.grad(loss)(at), 0, atol=1e-10)


def test_rigid_matrix_and_degenerate_similarity():
    source, target, weights = noisy_pairs(2)
    rotation, translation = rigid.kabsch(source, target, weights)
    h = rigid.fit_rigid(source, target, weights)
    np.testing.assert_array_equal(h[:2, :2], rotation)
    np.testing.assert_array_equal(h[:2, 2], translation)
    np.testing.assert_array_equal(rigid.fit_similarity(source, target, 0 * weights), np.eye(3))


@pytest.mark.parametrize("dimension", [2, 3])
def test_icp_finds_a_small_displacement_among_clutter(dimension):
    rng = np.random.default_rng(5)
    target = rng.uniform(-1, 1, (300, dimension))
    rotation = turn(0.03) if dimension == 2 else Rotation.from_rotvec([0.02, -0.03, 0.01]).as_matrix()
    shift = np.full(dimension, 0.02)
    source = (target[:200] - shift[None]) @ rotation
    source[:20] += 5
    valid = np.ones(200, bool)
    source[20:30], valid[20:30] = np.nan, False
    found, translation, inliers = rigid.icp(
        source,
        target,
        valid,
        np.ones(300, bool),
        np.eye(dimension),
        np.zeros(dimension),
        iterations=30,
        max_distance_m=0.1,
    )
    np.testing.assert_allclose(found, rotation, atol=1e-6)
    np.testing.assert_allclose(translation, shift, atol=1e-6)
    assert not inliers[:30].any() and inliers[30:].all()


def test_icp_without_pairs_keeps_the_guess():
    guess = turn(0.3)
    rotation, translation, inliers = rigid.icp(
        np.zeros((5, 2)), np.ones((4, 2)), np.ones(5, bool), np.zeros(4, bool), guess, np.ones(2), iterations=3
    )
    np.testing.assert_array_equal(rotation, guess)
    np.testing.assert_array_equal(translation, 1)
    assert not inliers.any()


def test_jit_vmap_and_float32():
    source, target, weights = (jnp.asarray(x, jnp.float32)[None].repeat(3, 0) for x in noisy_pairs(3))
    rotation, translation = jax.jit(jax.vmap(rigid.kabsch))(source, target, weights)
    assert rotation.shape == (3, 3, 3) and rotation.dtype == translation.dtype == jnp.float32
    flat = jax.vmap(rigid.fit_similarity)(source[..., :2], target[..., :2], weights)
    assert flat.dtype == rigid.fit_rigid(source[0, :, :2], target[0, :, :2], weights[0]).dtype == jnp.float32
    mask = jnp.ones((3, 30), bool)
    moved = jax.vmap(lambda *x: rigid.icp(*x, iterations=2))(source, target, mask, mask, rotation, translation)
    assert moved[0].dtype == jnp.float32
