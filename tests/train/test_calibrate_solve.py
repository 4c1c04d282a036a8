"""The solver on matches that are made up: random points of the floor, seen from poses that odometry knows or not."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.geometry.mount import base_from_mounted_camera
from ebjax.odometry.wheels import WheelErrors
from ebjax.train.calibrate_pairs import FloorPairs, motion_noise, relative_motion
from ebjax.train.calibrate_solve import count_agreeing, curvature_sigma, on_floor, residuals, solve

TRUE = np.array([np.radians(20), np.radians(1.0), np.radians(0.5), 0.55, 0.25, 0.05])
START = TRUE + np.array([np.radians(2.0), np.radians(-1.0), np.radians(-0.5), 0.04, 0.0, 0.0])
SIGMA = np.array([*np.radians([4.0, 2.0, 2.0]), 0.05, 0.0, 0.0])
STEPS = np.arange(25)  # 46 pairs of 64 matches, as in test_calibrate: the programs are compiled once
STRAIGHT = np.stack([0.25 * STEPS, 0 * STEPS, 0 * STEPS], 1)
TURNING = np.stack([0.15 * STEPS, 0 * STEPS, 0.15 * STEPS], 1)
NOISE_RAY = 0.002


def made_up(way, *, noise=0.0, wrong=0.0, odometry=None, seed=0, matches=64):
    """Matches between every frame and the next two, `wrong` of them random; odometry errs as it is said to."""
    rng = np.random.default_rng(seed)
    rows = np.arange(len(way) - 2)
    first, second = np.concatenate([rows, rows]), np.concatenate([rows + 1, rows + 2])
    pose = np.asarray(base_from_mounted_camera(TRUE))

    def rays(points):
        camera = (np.concatenate([points, np.zeros((*points.shape[:-1], 1))], -1) - pose[:3, 3]) @ pose[:3, :3]
        return camera / camera[..., 2:]

    motion = relative_motion(way, first, second)
    ahead = rng.uniform([0.9, -0.7], [2.4, 0.7], (len(first), matches, 2))
    c, s = np.cos(motion[:, 2])[:, None], np.sin(motion[:, 2])[:, None]
    x, y = ahead[..., 0] - motion[:, 0, None], ahead[..., 1] - motion[:, 1, None]
    both = np.stack([rays(ahead), rays(np.stack([c * x + s * y, c * y - s * x], -1))], 1)
    astray = rng.uniform(size=(len(first), matches)) < wrong
    both[:, 1][astray] = rays(rng.uniform([0.8, -0.8], [2.5, 0.8], (int(astray.sum()), 2)))
    both[..., :2] += noise * rng.normal(size=both[..., :2].shape)
    root = motion_noise(way, first, second, WheelErrors())
    if odometry is not None:
        motion = motion + np.einsum("pab,pb->pa", root, odometry * rng.normal(size=motion.shape))
    spreads = np.zeros((*both.shape, 2))
    spreads[..., :2, :] = NOISE_RAY * np.eye(2)
    return FloorPairs(*map(jnp.asarray, (both, spreads, np.ones(both.shape[:1] + both.shape[2:3]), motion, root)))


def test_nothing_is_left_at_the_truth():
    r, errors, distance = residuals(TRUE, made_up(TURNING), 2.0)
    assert float(jnp.abs(r).max()) < 1e-9
    assert float(jnp.abs(errors).max()) < 1e-9
    assert float(distance.max()) < 1e-5


def test_floor_points_and_their_deviations():
    rays = made_up(STRAIGHT).rays[0, 0]
    spreads = jnp.broadcast_to(jnp.eye(3)[:, :2], (*rays.shape, 2))
    points, slopes = on_floor(TRUE, rays, spreads)
    pose = np.asarray(base_from_mounted_camera(TRUE))
    world = np.asarray(rays) @ pose[:3, :3].T
    np.testing.assert_allclose(points, pose[:2, 3] - pose[2, 3] * world[:, :2] / world[:, 2:], atol=1e-12)
    for k in range(2):
        step = 1e-6 * jnp.eye(3)[k]
        moved = (on_floor(TRUE, rays + step[None], spreads)[0] - on_floor(TRUE, rays - step[None], spreads)[0]) / 2e-6
        np.testing.assert_allclose(slopes[..., k], moved, rtol=1e-6, atol=1e-8)
    jacobian = jax.jacfwd(lambda mount: on_floor(mount, rays, spreads)[0])(jnp.asarray(TRUE))
    for k, step in enumerate(1e-6 * np.eye(6)):
        moved = on_floor(TRUE + step, rays, spreads)[0] - on_floor(TRUE - step, rays, spreads)[0]
        np.testing.assert_allclose(jacobian[..., k], moved / 2e-6, rtol=1e-6, atol=1e-8)


@jax.jit
def terms(mount, pairs, width):
    r, errors, _ = residuals(mount, pairs, width)
    return jnp.concatenate([r.reshape(-1), errors.reshape(-1)])


@pytest.mark.parametrize(("wrong", "width", "slope"), [(0.0, 1000.0, 1e-8), (0.1, 3.0, 2e-4)])
def test_jacobian_against_central_differences(wrong, width, slope):
    """The slope of the cost is exact where the inner steps have converged, the Jacobian to first order in the noise."""
    pairs = made_up(TURNING, noise=NOISE_RAY, wrong=wrong, odometry=1.0)
    where = jnp.asarray(TRUE + 0.3 * (START - TRUE))
    jacobian = np.asarray(jax.jit(jax.jacfwd(terms))(where, pairs, width))
    ahead, behind = (np.stack([terms(where + d, pairs, width) for d in s * np.eye(6)], 1) for s in (1e-6, -1e-6))
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
    error = np.asarray(solve(START, SIGMA, rough.mount, right, 3.0).mount) - TRUE
    assert np.abs(np.degrees(error[:3])).max() < 0.02  # what is believed beforehand counts a little
    assert abs(error[3]) < 5e-4


def test_noise_does_not_pull_the_floor_closer():
    """Weighed by metres, the noise of so many matches would lower the camera by several percent."""
    errors = []
    for seed in range(4):
        pairs = made_up(TURNING, noise=NOISE_RAY, odometry=1.0, seed=seed)
        errors.append(np.asarray(solve(START, SIGMA, START, pairs, 3.0).mount) - TRUE)
    mean = np.mean(errors, axis=0)
    assert np.abs(np.degrees(mean[:2])).max() < 0.05
    assert abs(mean[3]) < 0.004


def test_what_a_run_does_not_tell_stays():
    sigma = np.array([*SIGMA[:4], 0.02, 0.02])
    straight, turning = made_up(STRAIGHT), made_up(TURNING)
    found = solve(START, sigma, START, straight, 3.0)
    np.testing.assert_allclose(found.mount[4:], START[4:], atol=1e-3)
    np.testing.assert_allclose(curvature_sigma(sigma, found.mount, straight, 3.0)[4:], sigma[4:], rtol=0.05)
    assert (np.asarray(curvature_sigma(sigma, TRUE, turning, 3.0)) < sigma / 2).all()
    elsewhere = START + np.array([0, 0, 0, 0, 0.02, -0.02])
    found = solve(elsewhere, sigma, elsewhere, turning, 3.0)
    np.testing.assert_allclose(found.mount[4:], TRUE[4:], atol=3e-3)


def test_most_matches_agree_at_the_truth():
    pairs = made_up(TURNING, noise=NOISE_RAY, wrong=0.5)
    mounts = np.stack([START, TRUE, TRUE + np.array([0, 0, 0, 0.05, 0, 0])])
    counts = np.asarray(count_agreeing(mounts, pairs, 12.0))
    assert np.argmax(counts) == 1
    assert counts[1] > 0.45 * pairs.valid.size
    assert not np.asarray(count_agreeing(mounts, dataclasses.replace(pairs, valid=0 * pairs.valid), 12.0)).any()
