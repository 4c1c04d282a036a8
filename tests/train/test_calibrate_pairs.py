import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.geometry import se2
from ebjax.odometry.wheels import WheelErrors
from ebjax.train.calibrate_pairs import MAX_TURN_DEG, SHARES, choose_pairs, motion_noise, relative_motion

WAY = np.stack([np.arange(60) * 0.1, 0.2 * np.sin(np.arange(60) * 0.2), 0.3 * np.sin(np.arange(60) * 0.15)], 1)
SPIN = np.stack([np.zeros(20), np.zeros(20), np.arange(20) * 0.2], 1)


def test_relative_motion_is_that_of_the_group():
    first, second = np.array([0, 5, 40]), np.array([3, 25, 59])
    expected = se2.compose(se2.inverse(jnp.asarray(WAY[first])), jnp.asarray(WAY[second]))
    np.testing.assert_allclose(relative_motion(WAY, first, second), np.asarray(expected), atol=1e-12)


def test_noise_is_that_of_noisy_steps():
    odometry = WheelErrors(translation=0.02, heading_deg_per_sqrt_m=2.0)
    rng = np.random.default_rng(0)
    first, second = 10, 22
    rows = np.arange(first, second)
    steps = relative_motion(WAY, rows, rows + 1)
    reached = np.zeros((20000, 3))
    for step, sigma in zip(steps, odometry.step_sigmas(WAY)[rows], strict=True):
        noisy = step + sigma * rng.normal(size=(len(reached), 3))
        c, s = np.cos(reached[:, 2]), np.sin(reached[:, 2])
        x, y = noisy[:, 0], noisy[:, 1]
        reached += np.stack([c * x - s * y, s * x + c * y, noisy[:, 2]], 1)
    root = motion_noise(WAY, np.array([first]), np.array([second]), odometry)[0]
    whitened = np.linalg.solve(root, (reached - reached.mean(0)).T)
    np.testing.assert_allclose(np.cov(whitened), np.eye(3), atol=0.06)


@pytest.mark.parametrize("way", [WAY, SPIN])
def test_pairs_move_by_shares_of_the_view(way):
    centre, length = np.array([1.2, 0.0]), 2.0
    first, second = choose_pairs(way, centre, length, 1000)
    assert len(np.unique(first)) >= len(way) - 4
    assert (first < second).all()
    c, s = np.cos(way[:, 2]), np.sin(way[:, 2])
    seen = way[:, :2] + np.stack([c * centre[0] - s * centre[1], s * centre[0] + c * centre[1]], 1)
    moved = np.linalg.norm(seen[second] - seen[first], axis=1)
    assert moved.min() >= SHARES[0] * length
    assert moved.max() <= (SHARES[-1] + SHARES[0]) * length
    assert np.degrees(np.abs(way[second, 2] - way[first, 2])).max() <= MAX_TURN_DEG


def test_no_more_pairs_than_wanted_spread_over_the_run():
    first, _ = choose_pairs(WAY, np.array([1.2, 0.0]), 2.0, 30)
    assert 20 <= len(first) <= 30
    assert first.min() == 0
    assert first.max() >= 50


def test_no_pairs_without_motion():
    first, second = choose_pairs(np.zeros((30, 3)), np.array([1.2, 0.0]), 2.0, 100)
    assert len(first) == len(second) == 0
