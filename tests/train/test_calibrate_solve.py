"""The solver on matches that are made up: random points of the floor, seen from poses that odometry knows or not."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.geometry.camera import Camera, project, raw_from_ideal, raw_slopes
from ebjax.geometry.lens import PINHOLE, lens
from ebjax.odometry.wheels import WheelErrors
from ebjax.train.calibrate_camera import COEFFICIENTS, INTRINSICS, coefficient_sigmas, numbers_of, with_numbers
from ebjax.train.calibrate_pairs import FloorPairs, motion_noise, relative_motion
from ebjax.train.calibrate_solve import count_agreeing, curvature_sigma, residuals, solve

K = np.array([[400.0, 0, 310.0], [0, 404.0, 245.0], [0, 0, 1]])
MOUNT = np.array([np.radians(20), np.radians(1.0), np.radians(0.5), 0.55, 0.25, 0.05])
LENSES = {
    "plumb_bob": lens("plumb_bob", [-0.2, 0.05, 1e-3, -2e-3, 0.01]),
    "equidistant": lens("equidistant", [0.05, -0.02, 0.01, -0.004]),
}


def camera_with(bent):
    numbers = np.concatenate([MOUNT, [K[0, 0], K[0, 2], K[1, 2]], bent.coefficients])
    return with_numbers(Camera(K, np.eye(4), 640, 480, bent), numbers)


CAMERA = camera_with(PINHOLE)
TRUE = numbers_of(CAMERA)
OFF = np.array([np.radians(2.0), np.radians(-1.0), np.radians(-0.5), 0.04, 0, 0, 0, 0, 0])
START = TRUE + OFF
SIGMA = np.array([*np.radians([4.0, 2.0, 2.0]), 0.05, 0, 0, 0, 0, 0])
STEPS = np.arange(25)  # 46 pairs of 64 matches, as in test_calibrate: the programs are compiled once
STRAIGHT = np.stack([0.25 * STEPS, 0 * STEPS, 0 * STEPS], 1)
TURNING = np.stack([0.15 * STEPS, 0 * STEPS, 0.15 * STEPS], 1)
NOISE_PX = 0.8


def made_up(way, *, noise=0.0, wrong=0.0, odometry=None, seed=0, matches=64, camera=CAMERA):
    """Matches between every frame and the next two, `wrong` of them random; odometry errs as it is said to."""
    rng = np.random.default_rng(seed)
    rows = np.arange(len(way) - 2)
    first, second = np.concatenate([rows, rows]), np.concatenate([rows + 1, rows + 2])

    def ideal(points):
        flat = np.concatenate([points.reshape(-1, 2), np.zeros((points.size // 2, 1))], 1)
        return project(camera, flat)[0]

    def pixels(points):
        return np.array(raw_from_ideal(camera, ideal(points))).reshape(points.shape)

    motion = relative_motion(way, first, second)
    ahead = rng.uniform([0.9, -0.7], [2.4, 0.7], (len(first), matches, 2))
    c, s = np.cos(motion[:, 2])[:, None], np.sin(motion[:, 2])[:, None]
    x, y = ahead[..., 0] - motion[:, 0, None], ahead[..., 1] - motion[:, 1, None]
    there = np.stack([ahead, np.stack([c * x + s * y, c * y - s * x], -1)], 1)
    both, slopes = pixels(there), np.asarray(raw_slopes(camera, ideal(there))).reshape(*there.shape, 2)
    astray = rng.uniform(size=(len(first), matches)) < wrong
    both[:, 1][astray] = pixels(rng.uniform([0.8, -0.8], [2.5, 0.8], (int(astray.sum()), 2)))
    both += noise * np.einsum("...ab,...b->...a", slopes, rng.normal(size=both.shape))
    root = motion_noise(way, first, second, WheelErrors())
    if odometry is not None:
        motion = motion + np.einsum("pab,pb->pa", root, odometry * rng.normal(size=motion.shape))
    valid = np.ones(both.shape[:1] + both.shape[2:3])
    return FloorPairs(camera, *map(jnp.asarray, (both, NOISE_PX * slopes, valid, motion, root)))


def test_nothing_is_left_at_the_truth():
    r, errors, distance = residuals(TRUE, made_up(TURNING), 2.0)
    assert float(jnp.abs(r).max()) < 1e-9
    assert float(jnp.abs(errors).max()) < 1e-9
    assert float(distance.max()) < 1e-5


@jax.jit
def terms(numbers, pairs, width):
    r, errors, _ = residuals(numbers, pairs, width)
    return jnp.concatenate([r.reshape(-1), errors.reshape(-1)])


slopes_of_terms = jax.jit(jax.jacfwd(terms))


def optics_sigma(camera):
    """Beliefs of a camera whose optics are tuned too."""
    return np.concatenate([SIGMA[:6], [0.02 * K[0, 0], 6.4, 6.4], coefficient_sigmas(camera, 12.8)])


@pytest.mark.slow
@pytest.mark.parametrize("model", [None, "plumb_bob"])
@pytest.mark.parametrize(("wrong", "width", "slope"), [(0.0, 1000.0, 1e-8), (0.1, 3.0, 5e-4)])
def test_jacobian_against_central_differences(wrong, width, slope, model):
    """The slope of the cost is exact where the inner steps have converged, the Jacobian to first order in the noise."""
    camera = CAMERA if model is None else camera_with(LENSES[model])
    pairs = made_up(TURNING, noise=NOISE_PX, wrong=wrong, odometry=1.0, camera=camera)
    true = numbers_of(camera)
    where = true + np.pad(0.3 * OFF, (0, len(true) - 9))
    where[COEFFICIENTS] *= 1.1
    sizes = np.where(np.arange(len(true)) < 6, 1, np.append(np.zeros(6), optics_sigma(camera)[6:]))
    jacobian = np.asarray(slopes_of_terms(where, pairs, width)) * sizes[None]
    ahead, behind = (np.stack([terms(where + d, pairs, width) for d in s * np.diag(sizes)], 1) for s in (1e-6, -1e-6))
    differences, at = (ahead - behind) / 2e-6, np.asarray(terms(where, pairs, width))
    np.testing.assert_allclose(at @ jacobian, at @ differences, atol=slope * np.abs(at @ differences).max())
    if not wrong:
        error = np.linalg.norm(jacobian - differences, axis=0) / np.linalg.norm(differences, axis=0)
        assert error.max() < 0.06


@pytest.mark.parametrize("way", [STRAIGHT, TURNING])
def test_recovers_the_mount_among_wrong_matches(way):
    pairs = made_up(way, wrong=0.2)
    rough = solve(START, SIGMA, START, pairs, 3.0)
    right = dataclasses.replace(pairs, valid=pairs.valid * (rough.distance < 9.0))
    error = np.asarray(solve(START, SIGMA, rough.numbers, right, 3.0).numbers) - TRUE
    assert np.abs(np.degrees(error[:3])).max() < 0.02  # what is believed beforehand counts a little
    assert abs(error[3]) < 5e-4


def test_noise_does_not_pull_the_floor_closer():
    """Weighed by metres, the noise of so many matches would lower the camera by several percent."""
    errors = []
    for seed in range(4):
        pairs = made_up(TURNING, noise=NOISE_PX, odometry=1.0, seed=seed)
        errors.append(np.asarray(solve(START, SIGMA, START, pairs, 3.0).numbers) - TRUE)
    mean = np.mean(errors, axis=0)
    assert np.abs(np.degrees(mean[:2])).max() < 0.05
    assert abs(mean[3]) < 0.004


@pytest.mark.slow
def test_what_a_run_does_not_tell_stays():
    sigma = np.array([*SIGMA[:4], 0.02, 0.02, 0, 0, 0])
    straight, turning = made_up(STRAIGHT), made_up(TURNING)
    found = solve(START, sigma, START, straight, 3.0)
    np.testing.assert_allclose(found.numbers[4:], START[4:], atol=1e-3)
    np.testing.assert_allclose(curvature_sigma(sigma, found.numbers, straight, 3.0)[4:], sigma[4:], rtol=0.05)
    assert (curvature_sigma(sigma, TRUE, turning, 3.0)[:6] < sigma[:6] / 2).all()
    elsewhere = START + np.array([0, 0, 0, 0, 0.02, -0.02, 0, 0, 0])
    found = solve(elsewhere, sigma, elsewhere, turning, 3.0)
    np.testing.assert_allclose(found.numbers[4:], TRUE[4:], atol=3e-3)


def test_most_matches_agree_at_the_truth():
    pairs = made_up(TURNING, noise=NOISE_PX, wrong=0.5)
    mounts = np.stack([START[:6], MOUNT, MOUNT + np.array([0, 0, 0, 0.05, 0, 0])])
    counts = np.asarray(count_agreeing(mounts, pairs, 12.0))
    assert np.argmax(counts) == 1
    assert counts[1] > 0.45 * pairs.valid.size
    assert not np.asarray(count_agreeing(mounts, dataclasses.replace(pairs, valid=0 * pairs.valid), 12.0)).any()


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.2, -1.0])
@pytest.mark.parametrize("model", LENSES)
def test_recovers_the_lens_with_the_mount(model, share):
    """The first radial coefficient a fifth too large, or missing."""
    camera = camera_with(LENSES[model])
    true, sigma = numbers_of(camera), optics_sigma(camera)
    sigma[INTRINSICS] = 0
    start = true + np.pad(OFF, (0, len(true) - 9))
    start[COEFFICIENTS.start] *= 1 + share
    pairs = dataclasses.replace(
        made_up(TURNING, noise=0.1 * NOISE_PX, camera=camera), camera=with_numbers(camera, start)
    )
    found = np.asarray(solve(start, sigma, start, pairs, 3.0).numbers)
    floor = np.concatenate([np.random.default_rng(1).uniform([0.9, -0.7], [2.4, 0.7], (99, 2)), np.zeros((99, 1))], 1)
    seen = [np.asarray(raw_from_ideal(one, project(one, floor)[0])) for one in (camera, with_numbers(camera, found))]
    assert np.abs(seen[0] - seen[1]).max() < 0.5
    k1 = COEFFICIENTS.start
    assert abs(found[k1] - true[k1]) < 3 * curvature_sigma(sigma, found, pairs, 3.0)[k1] < sigma[k1]
    np.testing.assert_array_equal(found[INTRINSICS], start[INTRINSICS])


@pytest.mark.slow
def test_a_plane_tells_less_of_the_intrinsics_than_of_the_lens():
    """A homography has eight degrees of freedom, mount and intrinsics have nine: some of them stay near the belief."""
    camera = camera_with(LENSES["plumb_bob"])
    sigma = optics_sigma(camera)
    left = curvature_sigma(sigma, numbers_of(camera), made_up(STRAIGHT, camera=camera), 3.0) / np.maximum(sigma, 1e-12)
    assert left[INTRINSICS].max() > 0.5 > left[COEFFICIENTS.start]


def test_a_match_that_the_lens_cannot_show_counts_as_a_wrong_one():
    camera = camera_with(LENSES["plumb_bob"])
    pairs = made_up(TURNING, camera=camera)
    folded = numbers_of(camera)
    folded[COEFFICIENTS.start] = -2.0  # folds back well inside the image
    r, _, distance = residuals(folded, pairs, 3.0)
    assert np.isfinite(r).all() and (np.asarray(distance) > 30).mean() > 0.5
    assert float(jnp.sum(r**2)) > 10 * float(jnp.sum(residuals(numbers_of(camera), pairs, 3.0)[0] ** 2)) + 1e3
