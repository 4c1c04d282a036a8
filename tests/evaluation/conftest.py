import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from ebjax.io.poses import poses_from


@pytest.fixture
def drive():
    """Gives poses of a planar drive of 120 s at any times within it, by seed: speeds up to 1 m/s, bends, stops."""

    def poses_at(seed, times):
        rng = np.random.default_rng(seed)
        knots, fine = np.linspace(0, 120, 61), np.linspace(0, 120, 12001)
        speed = np.clip(CubicSpline(knots, rng.normal(0.5, 0.3, 61))(fine), 0, 1)
        heading = np.cumsum(CubicSpline(knots, rng.normal(0, 0.4, 61))(fine)) * 0.01
        path = np.cumsum(speed[:, None] * np.stack([np.cos(heading), np.sin(heading), 0 * heading], 1), axis=0) * 0.01
        place = np.stack([np.interp(times, fine, path[:, k]) for k in range(3)], axis=1)
        turn = np.interp(times, fine, heading)[:, None] * np.array([[0, 0, 1.0]])
        return poses_from(Rotation.from_rotvec(turn).as_matrix(), place)

    return poses_at


@pytest.fixture
def drifted():
    """Adds a random walk of 3 mm a pose and noise of 5 mm and 0.3 degrees to poses."""

    def noisy(poses, seed):
        rng = np.random.default_rng(seed)
        result = poses.copy()
        shape = (len(poses), 3)
        result[:, :3, 3] += np.cumsum(rng.normal(0, 0.003, shape), axis=0) + rng.normal(0, 0.005, shape)
        result[:, :3, :3] = result[:, :3, :3] @ Rotation.from_rotvec(rng.normal(0, 0.005, shape)).as_matrix()
        return result

    return noisy
