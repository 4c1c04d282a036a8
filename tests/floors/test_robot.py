from dataclasses import replace

import numpy as np
import pytest

from ebjax.evaluation.trajectory import align_se2
from ebjax.floors.robot import RobotConfig, check, out_and_back, wheel_odometry

PERFECT = replace(
    RobotConfig(),
    translation_scale=1.0,
    rotation_scale=1.0,
    heading_bias_deg_per_m=0.0,
    translation_noise=0.0,
    rotation_noise_deg=0.0,
)


def test_path_goes_out_turns_and_comes_back_beside_itself():
    config = RobotConfig()
    poses = out_and_back(config, np.random.default_rng(0))
    x, y, heading = poses.T
    assert 85 <= len(poses) <= 95 and x.max() == pytest.approx(10.0)
    assert np.hypot(*np.diff(poses[:, :2], axis=0).T).max() < 0.27
    assert np.degrees(np.abs(np.diff(heading)).max()) <= config.turn_step_deg + 3
    back = x[np.argmax(heading > 3.0) :]
    assert np.all(np.diff(back) <= 0) and y[-1] == pytest.approx(-0.25, abs=0.04) and abs(y[0]) < 0.04


def test_wheels_never_slip_sideways():
    poses = out_and_back(replace(RobotConfig(), step_m=0.01), np.random.default_rng(1))
    step, middle = np.diff(poses, axis=0), (poses[1:, 2] + poses[:-1, 2]) / 2
    assert np.abs(-np.sin(middle) * step[:, 0] + np.cos(middle) * step[:, 1]).max() < 1e-4


def test_perfect_wheels_count_the_truth_from_the_first_pose():
    poses = out_and_back(replace(PERFECT, step_m=0.02), np.random.default_rng(2))
    counted = wheel_odometry(poses, PERFECT, np.random.default_rng(3))
    c, s = np.cos(poses[0, 2]), np.sin(poses[0, 2])
    expected = (poses[:, :2] - poses[0, :2]) @ np.array([[c, -s], [s, c]])
    assert np.all(counted[0] == 0) and np.abs(counted[:, :2] - expected).max() < 1e-3


@pytest.mark.parametrize("seed", range(5))
def test_default_wheels_drift_by_half_a_metre(seed):
    rng = np.random.default_rng(seed)
    poses = out_and_back(RobotConfig(), rng)
    counted = wheel_odometry(poses, RobotConfig(), rng)
    flat = [np.concatenate([p[:, :2], np.zeros((len(p), 1))], axis=1) for p in (counted, poses)]
    aligned = align_se2(*flat)
    error = flat[0] @ aligned[:3, :3].T + aligned[:3, 3] - flat[1]
    assert 0.3 < np.sqrt(np.mean(np.sum(error**2, axis=1))) < 0.8


@pytest.mark.parametrize("key, value", [("distance_m", 0.0), ("step_m", -0.1), ("rotation_noise_deg", -1.0)])
def test_bad_values_name_their_key(key, value):
    with pytest.raises(ValueError, match=f"robot.{key} is"):
        check(replace(RobotConfig(), **{key: value}))
