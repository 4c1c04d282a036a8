import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

from ebjax.features.measure import MATCHES_PER_PLACE, SHARED_SIGMA, lift, measure_depth, measure_floor
from ebjax.geometry.camera import camera_over_floor, project

MOTION = np.array([2.4, 0.2, np.pi - 0.1])


def move(motion, points):
    c, s = np.cos(motion[2]), np.sin(motion[2])
    return points @ np.array([[c, s], [-s, c]]) + motion[:2]


def make(count=40, noise=0.004, seed=0, size=2):
    random = np.random.default_rng(seed)
    points_j = random.uniform([0.8, -0.8, 0][:size], [2.4, 0.6, 0.002][:size], (count, size))
    points_i = points_j.copy()
    points_i[:, :2] = move(MOTION, points_j[:, :2])
    return points_i + noise * random.standard_normal(points_i.shape), points_j


def right_tangent(estimate):
    """Error in the frame of j: t = R^T (t' - t)."""
    c, s = np.cos(MOTION[2]), np.sin(MOTION[2])
    d = estimate[..., :2] - MOTION[:2]
    turn = np.mod(estimate[..., 2] - MOTION[2] + np.pi, 2 * np.pi) - np.pi
    return np.stack([c * d[..., 0] + s * d[..., 1], -s * d[..., 0] + c * d[..., 1], turn], -1)


def test_floor_measurement_is_least_squares_over_the_inliers():
    points_i, points_j = make()
    inliers = np.arange(40) % 3 > 0
    points_i[~inliers] += 1.0
    found = measure_floor(jnp.asarray(points_i), jnp.asarray(points_j), jnp.asarray(inliers))
    best = least_squares(lambda m: (points_i - move(m, points_j))[inliers].ravel(), MOTION).x
    np.testing.assert_allclose(found.i_from_j, best, atol=1e-7)
    rms = np.sqrt(np.mean(np.sum((points_i - move(best, points_j))[inliers] ** 2, 1)))
    np.testing.assert_allclose(found.residual_m, rms, rtol=1e-6)


def test_depth_measurement_weighs_by_range():
    points_i, points_j = make(size=3, noise=0.0)
    range_m = jnp.asarray(np.where(np.arange(40) < 20, 0.8, 4.0))
    points_i[20:, 0] += 0.05  # far points are wrong
    found = measure_depth(jnp.asarray(points_i), jnp.asarray(points_j), jnp.ones(40, bool), range_m)
    np.testing.assert_allclose(np.abs(right_tangent(np.asarray(found.i_from_j)))[:2], 0, atol=1e-3)
    plain = measure_depth(jnp.asarray(points_i), jnp.asarray(points_j), jnp.ones(40, bool), jnp.ones(40))
    assert np.abs(right_tangent(np.asarray(plain.i_from_j)))[:2].max() > 0.01


def test_covariance_is_what_monte_carlo_finds():
    random = np.random.default_rng(1)
    clean_i, points_j = make(noise=0.0)
    noisy = clean_i[None] + 0.01 * random.standard_normal((400, 40, 2))
    measure = jax.vmap(lambda i: measure_floor(i, jnp.asarray(points_j), jnp.ones(40, bool)))
    found = measure(jnp.asarray(noisy))
    scatter = np.cov(right_tangent(np.asarray(found.i_from_j)).T)
    shared = np.diag(np.square(SHARED_SIGMA))
    predicted = (np.asarray(found.covariance).mean(0) - shared) / MATCHES_PER_PLACE
    ratio = np.sqrt(np.diag(predicted) / np.diag(scatter))
    assert (ratio > 0.85).all() and (ratio < 1.15).all()
    correlation = lambda c: c / np.sqrt(np.outer(np.diag(c), np.diag(c)))  # noqa: E731
    np.testing.assert_allclose(correlation(predicted), correlation(scatter), atol=0.15)


def test_few_or_bunched_points_are_uncertain_not_nan():
    points_i, points_j = make()
    for inliers in (np.zeros(40, bool), np.arange(40) < 1):
        found = measure_floor(jnp.asarray(points_i), jnp.asarray(points_j), jnp.asarray(inliers))
        assert np.isfinite(found.i_from_j).all() and np.isfinite(found.covariance).all()
    wide = measure_floor(jnp.asarray(points_i), jnp.asarray(points_j), jnp.ones(40, bool))
    centre = points_j.mean(0)
    bunched_j = centre + 0.05 * (points_j - centre)
    bunched_i = move(MOTION, bunched_j) + points_i - move(MOTION, points_j)
    close = measure_floor(jnp.asarray(bunched_i), jnp.asarray(bunched_j), jnp.ones(40, bool))
    assert close.covariance[2, 2] > 20 * wide.covariance[2, 2]


def test_measurements_are_differentiable():
    points_i, points_j = (jnp.asarray(p) for p in make())
    inliers = jnp.ones(40, bool)
    value = lambda p: jnp.sum(measure_floor(p, points_j, inliers).i_from_j * jnp.array([1.0, 2.0, 3.0]))  # noqa: E731
    step = jnp.asarray(np.random.default_rng(2).standard_normal((40, 2)))
    numeric = (value(points_i + 1e-6 * step) - value(points_i - 1e-6 * step)) / 2e-6
    np.testing.assert_allclose(jnp.sum(jax.grad(value)(points_i) * step), numeric, rtol=1e-6)


def plane_depth(camera):
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    k, pose = np.asarray(camera.intrinsics), np.asarray(camera.base_from_camera)
    rays = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u)])
    down = np.einsum("j,jhw->hw", pose[2, :3], rays)
    return np.where(down < -1e-3, -pose[2, 3] / np.minimum(down, -1e-3), 0)


def test_lift_averages_noise_and_is_exact_on_a_plane():
    camera = camera_over_floor(300.0, 300.0, 159.5, 119.5, 320, 240, 0.5, np.radians(25))
    floor = np.random.default_rng(0).uniform([0.8, -0.4], [2.2, 0.4], (200, 2))
    points = np.concatenate([floor, np.zeros((200, 1))], 1)
    pixels, depth = project(camera, points)
    clean = plane_depth(camera)
    exact, range_m = lift(pixels, jnp.asarray(clean), camera)
    np.testing.assert_allclose(range_m, depth, rtol=0.01)  # the window is centred on whole pixels
    assert np.linalg.norm(np.asarray(exact) - points, axis=1).max() < 0.02
    noise = 0.02 * clean**2 * np.random.default_rng(1).standard_normal(clean.shape)
    noisy, _ = lift(pixels, jnp.asarray(clean + noise), camera)
    one_pixel, _ = lift(pixels, jnp.asarray(clean + noise), camera, radius=0)
    error = lambda found: np.sqrt(np.mean((np.asarray(found) - points)[:, 0] ** 2))  # noqa: E731
    assert error(noisy) < error(one_pixel) / 3


def test_lift_leaves_out_missing_depth():
    camera = camera_over_floor(300.0, 300.0, 159.5, 119.5, 320, 240, 0.5, np.radians(25))
    depth = plane_depth(camera)
    depth[:, :160] = 0
    depth[200:, 160:] = np.nan
    pixels = jnp.array([[80.0, 150], [240, 220], [240, 150], [-5, 150], [240, 300]])
    points, range_m = lift(pixels, jnp.asarray(depth), camera)
    np.testing.assert_array_equal(np.asarray(range_m) > 0, [False, False, True, False, False])
    assert np.isfinite(points).all()
    holes = plane_depth(camera)
    holes[::2] = 0
    some, _ = lift(pixels[2:3], jnp.asarray(holes), camera)
    np.testing.assert_allclose(some, points[2:3], atol=0.02)
