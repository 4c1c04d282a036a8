import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.features.landmarks import Landmarks
from ebjax.features.matching import Features
from ebjax.features.settle import (
    EXCESS,
    PairMatches,
    depth_motion,
    floor_motion,
    on_floor,
    pair_matches,
    settle,
    spread_on_floor,
)
from ebjax.features.verify import Verified
from ebjax.geometry import planar
from ebjax.geometry.camera import camera_over_floor, image_from_floor, project
from ebjax.geometry.homography import apply
from ebjax.geometry.mount import Mounting, remounted
from ebjax.views.run_view import RunView

AHEAD = np.array([-0.2, 0.02, 0.05])
NEARLY = np.array([0.01, -0.008, 0.004])
OPPOSITE = np.array([3.4, 0.1, np.pi - 0.04])
COUNT, DRAWS = 80, 200
TOLERANCE_M = 0.03
CAMERA = camera_over_floor(380.0, 380.0, 319.5, 239.5, 640, 480, 0.54, np.radians(19), 0.01, 0.27)
by_depth = jax.jit(depth_motion)


@jax.jit
def run(points_i, points_j, variance, *rest):
    """With the same variance in every direction."""
    return settle(points_i, points_j, variance[:, None, None] * jnp.eye(2, dtype=variance.dtype)[None], *rest)


@jax.jit
def by_floor(matches, change):
    """With pitch, roll and height of the camera changed by so much."""
    return floor_motion(matches, remounted(CAMERA, Mounting(*change)), TOLERANCE_M)


WEIGHTS = np.array([1.0, -2.0, 3.0])
forward_mode = jax.jit(jax.jacfwd(lambda change, matches: by_floor(matches, change).i_from_j))
reverse_mode = jax.jit(jax.grad(lambda change, matches: jnp.dot(by_floor(matches, change).i_from_j, WEIGHTS)))
told = jax.jit(jax.vmap(settle, in_axes=(0, 0, 0, 0, None, None)))
run_many = jax.jit(jax.vmap(run, in_axes=(0, 0, 0, 0, None, None)))


def move(motion, points):
    c, s = np.cos(motion[2]), np.sin(motion[2])
    return points @ np.array([[c, s], [-s, c]]) + motion[:2]


def patch(random, *shape):
    """Floor 1 to 2.9 m ahead."""
    return random.uniform([1.0, -0.7], [2.9, 0.7], (*shape, 2))


def error(found, motion):
    """log(found^-1 * true), right tangent."""
    found = np.asarray(found)
    return planar.log(planar.between(found, np.broadcast_to(motion, found.shape).copy()))


def nees(off, covariance):
    return np.einsum("na,nab,nb->n", off, np.linalg.inv(np.asarray(covariance)), off)


def variance_on_floor(points):
    """Of a millimetre, and of 0.18 px, of which one covers (h^2 + d^2) / (h f) at the distance d."""
    height, focal = float(CAMERA.base_from_camera[2, 3]), 380.0
    squared = np.sum((points - np.asarray(CAMERA.base_from_camera)[:2, 3]) ** 2, -1)
    return 1e-6 + (0.18 * (height**2 + squared) / (height * focal)) ** 2


def student(random, shape, freedom):
    return random.standard_normal(shape) / np.sqrt(random.chisquare(freedom, (*shape[:-1], 1)) / freedom)


@pytest.mark.parametrize("motion", [AHEAD, OPPOSITE])
def test_noise_free_points_give_the_motion_exactly(motion):
    random = np.random.default_rng(0)
    points_j = patch(random, COUNT)
    matched = np.arange(COUNT) % 4 > 0
    points_i = np.where(matched[:, None], move(motion, points_j), 50.0)
    start = motion + NEARLY
    found = run(points_i, points_j, variance_on_floor(points_j), matched, jnp.asarray(start), TOLERANCE_M)
    np.testing.assert_allclose(error(found.i_from_j, motion), 0, atol=1e-10)
    assert float(found.residual_m) < 1e-9


@pytest.mark.parametrize("motion", [AHEAD, OPPOSITE])
def test_gross_outliers_count_for_nothing(motion):
    random = np.random.default_rng(1)
    points_j = patch(random, COUNT)
    points_i = move(motion, points_j)
    wrong = np.arange(COUNT) < 0.3 * COUNT
    direction = random.uniform(0, 2 * np.pi, wrong.sum())
    away = random.uniform(0.06, 1.0, wrong.sum())[:, None]
    points_i[wrong] += away * np.stack([np.cos(direction), np.sin(direction)], 1)
    start = jnp.asarray(motion + NEARLY)
    found = run(points_i, points_j, variance_on_floor(points_j), np.ones(COUNT, bool), start, TOLERANCE_M)
    np.testing.assert_allclose(error(found.i_from_j, motion), 0, atol=1e-10)


@pytest.mark.parametrize("motion", [AHEAD, OPPOSITE])
def test_outliers_within_the_tolerance_do_little_harm(motion):
    random = np.random.default_rng(2)
    points_j = patch(random, DRAWS, COUNT)
    points_i = np.stack([move(motion, p) for p in points_j])
    variance = variance_on_floor(points_j)
    points_i += np.sqrt(variance)[..., None] * random.standard_normal(points_i.shape)
    points_i[:, : 3 * COUNT // 10] += random.uniform(-0.03, 0.03, (DRAWS, 3 * COUNT // 10, 2))
    found = run_many(points_i, points_j, variance, np.ones((DRAWS, COUNT), bool), jnp.asarray(motion), 0.06)
    rms = np.sqrt(np.mean(error(found.i_from_j, motion) ** 2, 0))
    assert (rms < [0.0015, 0.005, 0.0025]).all()
    assert nees(error(found.i_from_j, motion), found.covariance).mean() < 6


@pytest.mark.parametrize("motion", [AHEAD, OPPOSITE])
@pytest.mark.parametrize("freedom", [3, 4])
def test_covariance_is_as_large_as_the_errors_of_heavy_tailed_noise(freedom, motion):
    random = np.random.default_rng(freedom)
    points_j = patch(random, DRAWS, COUNT)
    points_i = np.stack([move(motion, p) for p in points_j])
    of_j = variance_on_floor(points_j)
    of_i = of_j if motion is OPPOSITE else variance_on_floor(points_i)
    points_i += np.sqrt(of_i)[..., None] * student(random, points_i.shape, freedom)
    points_j = points_j + np.sqrt(of_j)[..., None] * student(random, points_j.shape, freedom)
    found = run_many(points_i, points_j, of_i + of_j, np.ones((DRAWS, COUNT), bool), jnp.asarray(motion), TOLERANCE_M)
    covariance = np.asarray(found.covariance) / EXCESS
    assert 2.7 < nees(error(found.i_from_j, motion), covariance).mean() < 5.6
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert (covariance[:, 1, 2] / (sigma[:, 1] * sigma[:, 2]) < -0.9).all()
    scatter = np.std(error(found.i_from_j, motion), 0)
    np.testing.assert_allclose(scatter, np.sqrt(np.mean(sigma**2, 0)), rtol=0.25)


def test_noise_larger_than_expected_shows_in_the_covariance():
    random = np.random.default_rng(5)
    points_j = patch(random, COUNT)
    variance, noise = variance_on_floor(points_j), random.standard_normal((COUNT, 2))
    few, many = (
        run(
            move(AHEAD, points_j) + factor * np.sqrt(variance)[:, None] * noise,
            points_j,
            variance,
            np.ones(COUNT, bool),
            jnp.asarray(AHEAD),
            1.0,
        )
        for factor in (1.0, 3.0)
    )
    np.testing.assert_allclose(many.covariance, 9 * few.covariance, rtol=0.02)
    assert float(many.residual_m) == pytest.approx(3 * float(few.residual_m), rel=0.02)


def test_matches_that_slide_along_a_grain_say_little_of_it():
    """Errors along x are twenty times those along y, as on a wooden floor; a few matches have both."""
    random = np.random.default_rng(13)
    points_j = patch(random, DRAWS, COUNT)
    sigma = np.where(np.arange(COUNT)[:, None] % 10 > 0, [0.004, 0.0002], [0.0002, 0.0002])
    points_i = np.stack([move(AHEAD, p) for p in points_j]) + sigma * random.standard_normal(points_j.shape)
    known = np.broadcast_to(np.einsum("ma,ab->mab", sigma**2, np.eye(2)), (DRAWS, COUNT, 2, 2))
    all_ = np.ones((DRAWS, COUNT), bool)
    found = told(points_i, points_j, known, all_, jnp.asarray(AHEAD), 0.06)
    alike = run_many(points_i, points_j, np.full((DRAWS, COUNT), 1e-6), all_, jnp.asarray(AHEAD), 0.06)
    ours, theirs = (np.sqrt(np.mean(error(x.i_from_j, AHEAD) ** 2, 0)) for x in (found, alike))
    assert ours[0] < 0.3 * theirs[0]
    assert 2.5 < nees(error(found.i_from_j, AHEAD), np.asarray(found.covariance) / EXCESS).mean() < 4.5


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_points_are_uncertain_not_nan(count):
    points_j = patch(np.random.default_rng(6), COUNT)
    matched = np.arange(COUNT) < count
    found = run(move(AHEAD, points_j), points_j, np.full(COUNT, 1e-5), matched, jnp.asarray(AHEAD), TOLERANCE_M)
    np.testing.assert_allclose(found.i_from_j, AHEAD, atol=1e-9)
    assert np.isfinite(found.covariance).all()
    assert np.linalg.eigvalsh(found.covariance).min() > 0
    if count < 2:
        assert np.linalg.eigvalsh(found.covariance).max() > 1e4


def test_single_precision_is_enough():
    random = np.random.default_rng(7)
    points_j = patch(random, COUNT)
    variance = variance_on_floor(points_j)
    points_i = move(OPPOSITE, points_j) + np.sqrt(variance)[:, None] * student(random, points_j.shape, 3)
    values = points_i, points_j, variance, np.ones(COUNT, bool), OPPOSITE
    double = run(*map(jnp.asarray, values), TOLERANCE_M)
    single = run(*(jnp.asarray(v, bool if v.dtype == bool else np.float32) for v in values), TOLERANCE_M)
    assert single.i_from_j.dtype == single.covariance.dtype == np.float32
    np.testing.assert_allclose(single.i_from_j, double.i_from_j, atol=2e-5)
    np.testing.assert_allclose(single.covariance, double.covariance, rtol=2e-2, atol=1e-9)


def noisy_matches(random, motion, noise_px=0.3, wrong=10):
    """Pixels of floor points seen from two places, some of them mismatched, and the points' depths."""
    points_j = patch(random, COUNT)
    pixels, points = [], []
    for floor in (move(motion, points_j), points_j):
        seen, depth = project(CAMERA, np.concatenate([floor, np.zeros((COUNT, 1))], 1))
        rays = np.concatenate([np.asarray(seen), np.ones((COUNT, 1))], 1) @ np.linalg.inv(CAMERA.intrinsics).T
        points.append(jnp.asarray(rays * np.asarray(depth)[:, None]))
        pixels.append(np.asarray(seen) + noise_px * student(random, (COUNT, 2), 4))
    pixels[0][:wrong] += random.uniform(30, 60, (wrong, 2))
    matched, alike = jnp.ones(COUNT, bool), jnp.broadcast_to(jnp.eye(2), (COUNT, 2, 2))
    return PairMatches(*map(jnp.asarray, pixels), *points, matched, jnp.asarray(motion), alike)


def test_floor_motion_recovers_the_motion():
    found = by_floor(noisy_matches(np.random.default_rng(8), AHEAD, 0.0), jnp.zeros(3))
    np.testing.assert_allclose(error(found.i_from_j, AHEAD), 0, atol=1e-9)
    noisy = by_floor(noisy_matches(np.random.default_rng(8), AHEAD), jnp.zeros(3))
    off = error(noisy.i_from_j, AHEAD)
    assert off @ np.linalg.solve(noisy.covariance, off) < 16.27


def test_pixels_come_back_to_the_floor():
    points = patch(np.random.default_rng(14), COUNT)
    pixels = apply(image_from_floor(CAMERA), jnp.asarray(points))
    np.testing.assert_allclose(on_floor(pixels, CAMERA), points, atol=1e-9)


def test_a_pixel_spreads_over_more_floor_the_farther_it_is():
    matches = noisy_matches(np.random.default_rng(15), AHEAD, 0.0, wrong=0)
    points, _, spread = jax.jit(spread_on_floor)(matches, CAMERA)
    assert np.corrcoef(points[:, 0], np.log(np.linalg.det(spread)))[0, 1] > 0.95
    pixel = 1e-3
    for axis in (0, 1):
        moved = on_floor(matches.pixels_i + pixel * jnp.eye(2)[None, axis], CAMERA) - points
        slopes = moved / pixel
        along = np.asarray(slopes[:, :, None] * slopes[:, None, :])
        spread = spread - along
    np.testing.assert_allclose(spread, 0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("motion", [AHEAD, OPPOSITE])
def test_floor_motion_is_differentiable_in_the_camera(motion):
    matches = noisy_matches(np.random.default_rng(9), motion)
    here = jnp.array([0.004, -0.006, 0.01])  # pitch, roll, height
    forward, reverse = forward_mode(here, matches), reverse_mode(here, matches)
    step = 1e-6
    ends = [[by_floor(matches, here + sign * step * e).i_from_j for sign in (1, -1)] for e in jnp.eye(3)]
    numeric = np.stack([(above - below) / (2 * step) for above, below in ends], 1)
    assert (np.abs(numeric).max(0) > 0.005).all(), "every number of the mount is to move the motion here"
    np.testing.assert_allclose(forward, numeric, rtol=1e-5, atol=1e-6 * np.abs(numeric).max())
    np.testing.assert_allclose(reverse, WEIGHTS @ numeric, rtol=1e-5)


@pytest.mark.slow
def test_derivatives_hold_where_the_points_fit_exactly():
    matches = noisy_matches(np.random.default_rng(13), AHEAD, 0.0, 0)
    for slope in (forward_mode, reverse_mode):
        assert np.isfinite(slope(jnp.zeros(3), matches)).all()


@pytest.mark.parametrize("motion", [AHEAD, OPPOSITE])
def test_depth_motion_recovers_the_motion_and_says_which_matches_have_depth(motion):
    random = np.random.default_rng(10)
    matches = noisy_matches(random, motion, 0.0, 0)
    without_i, without_j, unmatched = (np.arange(COUNT) % k == 0 for k in (5, 7, 11))
    matches = dataclasses.replace(
        matches,
        points_i=jnp.where(without_i[:, None], 0, matches.points_i),
        points_j=jnp.where(without_j[:, None], 0, matches.points_j),
        matched=jnp.asarray(~unmatched),
        start=jnp.asarray(motion + NEARLY),
    )
    found, deep = by_depth(matches, CAMERA, TOLERANCE_M)
    np.testing.assert_array_equal(deep, ~(without_i | without_j | unmatched))
    np.testing.assert_allclose(error(found.i_from_j, motion), 0, atol=1e-9)
    nothing, deep = by_depth(dataclasses.replace(matches, points_j=jnp.zeros((COUNT, 3))), CAMERA, TOLERANCE_M)
    assert not deep.any()
    assert np.linalg.eigvalsh(nothing.covariance).max() > 1e4


def test_depth_does_not_care_how_high_the_camera_is_said_to_be():
    matches = noisy_matches(np.random.default_rng(11), AHEAD, 0.0, 0)
    pose = np.array(CAMERA.base_from_camera)
    pose[2, 3] += 0.05
    higher = dataclasses.replace(CAMERA, base_from_camera=jnp.asarray(pose))
    deep, _ = by_depth(matches, higher, TOLERANCE_M)
    np.testing.assert_allclose(error(deep.i_from_j, AHEAD), 0, atol=1e-9)
    floor = by_floor(matches, jnp.array([0.0, 0.0, 0.05]))
    assert np.hypot(*floor.i_from_j[:2]) > 1.08 * np.hypot(*AHEAD[:2])


def test_pair_matches_gathers_the_rows_that_match():
    random = np.random.default_rng(12)

    def landmarks(range_m):
        pixels = jnp.asarray(random.uniform(0, 400, (6, 2)))
        features = Features(pixels, jnp.zeros((6, 4)), jnp.ones(6, bool))
        grey = np.zeros((9, 9), np.uint8)
        return Landmarks(features, jnp.zeros((6, 2)), jnp.zeros((6, 3)), jnp.asarray(range_m), pixels, grey)

    ours, theirs = landmarks(np.arange(6.0)), landmarks(np.full(6, 2.0))
    rows, other, matched = jnp.array([3, 0, 5, 1]), jnp.array([2, 4, 1, 1]), jnp.array([True, True, True, False])
    c, s = np.cos(2.9), np.sin(2.9)
    motion = jnp.array([[c, -s, 0.3], [s, c, -0.1], [0, 0, 1]])
    view = RunView(jnp.eye(3), jnp.eye(3), jnp.ones((9, 9), bool))
    found = jax.jit(pair_matches)(ours, theirs, Verified(rows, other, matched, matched, motion), view, CAMERA)
    np.testing.assert_allclose(found.pixels_i, ours.pixels[rows], atol=1e-9)
    np.testing.assert_array_equal(found.pixels_j, theirs.pixels[other])
    np.testing.assert_allclose(found.start, [0.3, -0.1, 2.9], atol=1e-12)
    np.testing.assert_array_equal(found.points_i[:, 2], [3.0, 0.0, 5.0, 1.0])
    np.testing.assert_array_equal(found.points_i[1], np.zeros(3))
    lifted = found.points_j @ CAMERA.intrinsics.T
    np.testing.assert_allclose(lifted[:, :2] / lifted[:, 2:], theirs.pixels[other], atol=1e-9)
    np.testing.assert_array_equal(found.matched, matched)
    assert found.spread.shape == (4, 2, 2) and (np.linalg.eigvalsh(found.spread) > 0).all()
