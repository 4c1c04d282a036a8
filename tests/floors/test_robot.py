from dataclasses import replace

import numpy as np
import pytest

from ebjax.evaluation.trajectory import align_se2
from ebjax.floors.robot import WHEELS, RobotConfig, check, drive, route, step_signs, wheel_odometry

PERFECT = replace(RobotConfig(), drift=0.0)
BENT = replace(RobotConfig(), route="0 0, 8 0, 8 6, 8 0, 12 0", passes=3)


def test_path_goes_out_turns_and_comes_back_beside_itself():
    config = RobotConfig()
    poses, passes = drive(config, np.random.default_rng(0))
    x, y, heading = poses.T
    assert 85 <= len(poses) <= 95 and x.max() == pytest.approx(10.0)
    assert np.hypot(*np.diff(poses[:, :2], axis=0).T).max() < 0.27
    assert np.degrees(np.abs(np.diff(heading)).max()) <= config.turn_step_deg + 0.1
    back = x[np.argmax(heading > 3.0) :]
    assert np.all(np.diff(back) <= 0) and np.abs(y[[0, -1]]).max() < 1e-9
    middle = (passes == 1) & (np.abs(x - 5) < 1.5)
    np.testing.assert_allclose(y[middle], -0.25, atol=0.04)
    assert set(passes) == {0, 1} and np.all(np.diff(passes) >= 0)


@pytest.mark.parametrize("config", [RobotConfig(), BENT, replace(BENT, reverse=True)])
def test_wheels_never_slip_sideways(config):
    poses, _ = drive(replace(config, step_m=0.01, turn_step_deg=1.0), np.random.default_rng(1))
    step, middle = np.diff(poses, axis=0), (poses[1:, 2] + poses[:-1, 2]) / 2
    assert np.abs(-np.sin(middle) * step[:, 0] + np.cos(middle) * step[:, 1]).max() < 3e-4


def test_a_route_is_driven_with_its_bends_and_reversals_in_every_pass():
    poses, passes = drive(BENT, np.random.default_rng(0))
    for corner in route(BENT)[[0, 2, 4]]:
        assert np.hypot(*(poses[:, :2] - corner).T).min() < 0.01
    assert np.hypot(*(poses[:, :2] - [8, 0]).T).min() < 0.5
    assert set(passes) == {0, 1, 2}
    assert np.degrees(np.abs(np.diff(poses[:, 2]))).max() < BENT.turn_step_deg + 1
    assert np.hypot(*np.diff(poses[:, :2], axis=0).T).max() < 0.26


def test_in_reverse_the_way_back_is_driven_without_turning_round():
    forth, _ = drive(RobotConfig(), np.random.default_rng(0))
    poses, passes = drive(replace(RobotConfig(), reverse=True), np.random.default_rng(0))
    assert np.degrees(np.abs(poses[:, 2])).max() < 20 and np.hypot(*np.diff(poses[:, :2], axis=0).T).max() < 0.27
    assert np.all(step_signs(poses)[passes[1:] == 0] == 1) and np.all(step_signs(poses)[passes[1:] == 1] == -1)
    # Both go back the same way.
    np.testing.assert_allclose(poses[passes == 1][-20:, :2], forth[-20:, :2], atol=1e-9)
    np.testing.assert_allclose(np.abs(poses[passes == 1][-20:, 2] - forth[-20:, 2]), np.pi)
    bent, _ = drive(replace(BENT, reverse=True), np.random.default_rng(0))
    assert np.degrees(np.abs(np.diff(bent[:, 2]))).max() < BENT.turn_step_deg + 1


def test_backwards_wheels_count_back():
    config = replace(RobotConfig(), reverse=True, lateral_offset_m=0.0, weave_m=0.0, drift=0.0)
    poses, _ = drive(config, np.random.default_rng(0))
    counted = wheel_odometry(poses, config, np.random.default_rng(0))
    assert counted[:, 0].max() == pytest.approx(10.0) and np.abs(counted[-1]).max() < 1e-9
    # A wheel that is too large counts too much both ways, and its turn comes undone.
    biased = wheel_odometry(poses, replace(config, drift=1.0, wheels="mobilesim"), np.random.default_rng(0))
    assert abs(biased[:, 0].max() - 10) > 1e-3 and np.abs(biased[-1]).max() < 1e-9


@pytest.mark.parametrize("wheels", WHEELS)
def test_standing_counts_nothing(wheels):
    config = replace(RobotConfig(), stops=4, wheels=wheels)
    poses, _ = drive(config, np.random.default_rng(0))
    stands = np.all(np.diff(poses, axis=0) == 0, axis=1)
    assert stands.sum() == 12
    counted = np.diff(wheel_odometry(poses, config, np.random.default_rng(0)), axis=0)
    assert np.all(counted[stands] == 0) and np.all(np.abs(counted[~stands]).max(axis=1) > 0)


def test_wheels_count_what_they_roll_up_a_ramp():
    poses, _ = drive(PERFECT, np.random.default_rng(0))
    level = wheel_odometry(poses, PERFECT, np.random.default_rng(0))
    steep = wheel_odometry(poses, PERFECT, np.random.default_rng(0), 0.75 * poses[:, 0])
    straight = slice(15, 25)
    np.testing.assert_allclose(np.diff(steep[straight, 0]), 1.25 * np.diff(level[straight, 0]), rtol=1e-3)


def test_stops_repeat_a_pose():
    moving, standing = (drive(replace(RobotConfig(), stops=n), np.random.default_rng(0))[0] for n in (0, 3))
    assert len(standing) == len(moving) + 9
    assert np.sum(np.all(np.diff(standing, axis=0) == 0, axis=1)) == 9


@pytest.mark.parametrize("config", [PERFECT, replace(BENT, drift=0.0), replace(BENT, drift=0.0, reverse=True)])
def test_perfect_wheels_count_the_truth_from_the_first_pose(config):
    poses, _ = drive(replace(config, step_m=0.02, turn_step_deg=2.0), np.random.default_rng(2))
    counted = wheel_odometry(poses, config, np.random.default_rng(3))
    c, s = np.cos(poses[0, 2]), np.sin(poses[0, 2])
    expected = (poses[:, :2] - poses[0, :2]) @ np.array([[c, -s], [s, c]])
    assert np.all(counted[0] == 0) and np.abs(counted[:, :2] - expected).max() < 2e-3


@pytest.mark.parametrize("seed", range(5))
def test_default_wheels_drift_by_half_a_metre(seed):
    rng = np.random.default_rng(seed)
    poses, _ = drive(RobotConfig(), rng)
    counted = wheel_odometry(poses, RobotConfig(), rng)
    flat = [np.concatenate([p[:, :2], np.zeros((len(p), 1))], axis=1) for p in (counted, poses)]
    aligned = align_se2(*flat)
    error = flat[0] @ aligned[:3, :3].T + aligned[:3, 3] - flat[1]
    assert 0.3 < np.sqrt(np.mean(np.sum(error**2, axis=1))) < 0.8


@pytest.mark.parametrize("name", WHEELS)
def test_wheels_drift_as_their_names_say(name):
    config = replace(RobotConfig(), distance_m=41.0, lateral_offset_m=0.0, weave_m=0.0, wheels=name)
    turned, counted = [], []
    for seed in range(30):
        poses, _ = drive(config, np.random.default_rng(seed))
        odometry = wheel_odometry(poses, config, np.random.default_rng(seed))
        turned.append(np.degrees(odometry[-1, 2] - (poses[-1, 2] - poses[0, 2])))
        counted.append(np.hypot(*np.diff(odometry[:, :2], axis=0).T).sum() / 82 - 1)
    if name == "d5":
        assert np.mean(turned) == pytest.approx(25 + 1.8, abs=2)
    if name in ("mobilesim", "stage"):
        limit = {"mobilesim": 0.0075, "stage": 0.03}[name]
        assert 0.6 * limit < np.abs(counted).max() < 1.02 * limit
        assert np.abs(turned).max() < 180 * {"mobilesim": 0.0075, "stage": 0.05}[name] + 0.01


@pytest.mark.parametrize("key, value", [("distance_m", 0.0), ("step_m", -0.1), ("drift", -1.0), ("route", "0 0")])
def test_bad_values_name_their_key(key, value):
    with pytest.raises(ValueError, match=f"robot.{key} is"):
        check(replace(RobotConfig(), **{key: value}))


@pytest.mark.parametrize("spread", [0.05, 0.2, 0.4])
def test_passes_spread_over_their_lanes(spread):
    config = RobotConfig(passes=20, weave_m=0.0, lateral_spread_m=spread)
    poses, passes = drive(config, np.random.default_rng(0))
    y = np.array([poses[(passes == p) & (np.abs(poses[:, 0] - 5) < 1), 1].mean() for p in range(20)])
    off = np.where(np.arange(20) % 2, -y - config.lateral_offset_m, y)
    assert np.abs(off).max() <= spread + 1e-6 and np.ptp(off) > 1.2 * spread
    ends = poses[np.flatnonzero(np.diff(passes))]
    assert np.abs(ends[:, 1]).max() < 1e-9
