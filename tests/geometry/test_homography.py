"""Homographies against OpenCV, their gradients, and their behaviour at the horizon."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.geometry import homography

QUAD = np.array([[180.0, 299], [460, 290], [585, 443], [66, 462]])
SQUARE = np.array([[0.0, 0], [399, 0], [399, 399], [0, 399]])


@pytest.fixture
def points():
    return np.random.default_rng(0).uniform(0, 399, (40, 2))


def test_four_points_equal_opencv():
    expected = cv2.getPerspectiveTransform(SQUARE.astype(np.float32), QUAD.astype(np.float32))
    ours = homography.from_four_points(SQUARE, QUAD)
    np.testing.assert_allclose(ours, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(homography.apply(ours, SQUARE), QUAD, atol=1e-9)


def test_four_points_on_one_line_stay_finite():
    line = np.stack([np.arange(4.0), np.arange(4.0)], axis=1)
    assert jnp.all(jnp.isfinite(homography.from_four_points(line, QUAD)))
    assert jnp.all(jnp.isfinite(homography.from_four_points(np.zeros((4, 2)), QUAD)))


def test_apply_equals_opencv(points):
    h = np.array(homography.from_four_points(SQUARE, QUAD))
    expected = cv2.perspectiveTransform(points[None], h)[0]
    np.testing.assert_allclose(homography.apply(h, points), expected, rtol=1e-12)


def test_apply_is_finite_and_keeps_its_sign_at_the_horizon():
    h = np.array([[1.0, 0, 0], [0, 1, 0], [0, -0.01, 1]])
    points = np.array([[5.0, 100], [5, 100 - 1e-9], [5, 100 + 1e-9], [0, 100]])
    mapped = np.array(homography.apply(h, points))
    assert np.isfinite(mapped).all()
    assert mapped[1, 0] > 0 > mapped[2, 0]
    gradient = jax.jacobian(lambda m, p: homography.apply(m, p), argnums=(0, 1))(jnp.asarray(h), jnp.asarray(points))
    assert all(np.isfinite(g).all() for g in gradient)


def test_fit_recovers_exact_pairs_and_ignores_weightless_ones(points):
    h = np.array(homography.from_four_points(SQUARE, QUAD))
    target = np.array(homography.apply(h, points))
    target[::4] += 50
    weights = np.ones(len(points))
    weights[::4] = 0
    np.testing.assert_allclose(homography.fit(points, target, weights), h, rtol=1e-8, atol=1e-11)


def test_fit_is_near_the_geometric_optimum_of_opencv(points):
    h = np.array(homography.from_four_points(SQUARE, QUAD))
    exact = np.array(homography.apply(h, points))
    target = exact + np.random.default_rng(1).normal(0, 0.3, points.shape)
    expected, _ = cv2.findHomography(points, target, 0)

    def rms(m):
        return np.sqrt(np.mean((np.array(homography.apply(m, points)) - target) ** 2))

    assert rms(np.array(homography.fit(points, target, np.ones(len(points))))) < 1.05 * rms(expected)


def test_integer_weights_repeat_points(points):
    target = np.array(homography.apply(homography.from_four_points(SQUARE, QUAD), points))
    target += np.random.default_rng(2).normal(0, 1, points.shape)
    repeats = np.arange(len(points)) % 3
    weighted = homography.fit(points, target, repeats.astype(float))
    repeated = homography.fit(points.repeat(repeats, 0), target.repeat(repeats, 0), np.ones(repeats.sum()))
    np.testing.assert_allclose(weighted, repeated, rtol=1e-9, atol=1e-12)


def test_fit_gradient_against_central_differences(points):
    rng = np.random.default_rng(3)
    target = np.array(homography.apply(homography.from_four_points(SQUARE, QUAD), points)) + rng.normal(0, 1, (40, 2))
    inputs = (jnp.asarray(points), jnp.asarray(target), jnp.asarray(rng.uniform(0.5, 1.5, 40)))

    @jax.jit
    def value(*x):
        return jnp.sum(homography.apply(homography.fit(*x), SQUARE) * jnp.array([1.0, -0.5])[None, :])

    directions = [jnp.asarray(rng.normal(size=x.shape)) for x in inputs]
    _, slope = jax.jvp(value, inputs, tuple(directions))
    ahead, behind = (value(*(x + e * d for x, d in zip(inputs, directions, strict=True))) for e in (1e-5, -1e-5))
    np.testing.assert_allclose(slope, (ahead - behind) / 2e-5, rtol=1e-5)
    assert all(np.isfinite(g).all() for g in jax.grad(value, argnums=(0, 1, 2))(*inputs))


def test_orient_makes_the_given_point_lie_in_front():
    floor_from_image = homography.from_four_points(QUAD, SQUARE)
    image_from_floor = homography.orient(jnp.linalg.inv(floor_from_image), np.array([200.0, 200.0]))
    assert np.all(homography.denominator(image_from_floor, SQUARE) > 0)


def test_rotate_pi_and_flip_are_involutions(points):
    for matrix in (homography.rotate_pi_matrix(640, 480), homography.flip_lr_matrix(640, 480)):
        np.testing.assert_array_equal(matrix @ matrix, np.eye(3))
    np.testing.assert_allclose(homography.apply(homography.rotate_pi_matrix(640, 480), np.zeros((1, 2))), [[639, 479]])


def test_jit_vmap_and_float32(points):
    p = jnp.asarray(points, jnp.float32)
    h = homography.from_four_points(SQUARE.astype(np.float32), QUAD.astype(np.float32))
    assert (
        h.dtype == homography.apply(h, p).dtype == homography.fit(p, p, jnp.ones(40, jnp.float32)).dtype == jnp.float32
    )
    both = jax.jit(jax.vmap(homography.fit, in_axes=(None, 0, None)))(
        p, jnp.stack([p, 2 * p]), jnp.ones(40, jnp.float32)
    )
    np.testing.assert_allclose(both, np.stack([np.eye(3), np.diag([2, 2, 1])]), atol=2e-3)


def test_slopes_are_the_derivative_of_apply():
    matrix = jnp.array([[1.2, 0.3, 40.0], [-0.1, 0.8, 7.0], [1e-3, 2e-3, 1.0]])
    points = jnp.array([[3.0, 4.0], [60.0, 20.0], [0.0, 0.0]])
    by_jax = jax.vmap(jax.jacfwd(lambda point: homography.apply(matrix, point[None])[0]))(points)
    np.testing.assert_allclose(homography.slopes(matrix, points), by_jax, rtol=1e-12)
