"""Roll and pitch from an IMU's topic, for odometry that has none."""

import numpy as np

from ebjax.geometry.lean_numbers import headings, levels_from_usual, spread_deg, turned
from ebjax.io.logs.ros_tf import TfTree
from ebjax.io.timed_poses import poses_at
from ebjax.io.trajectory import Trajectory

MAX_GAP_S = 0.2
"""A robot nods once in a second: samples farther apart say nothing of the time between."""
LEAST_COVERED = 0.9
LEAST_DEG = 0.02
"""Roll and pitch that change by less over a log are no measurement."""


def leant_by_imu(
    odometry: Trajectory, imu: Trajectory, frame: str, tree: TfTree, base: str | None
) -> tuple[Trajectory, tuple[str, ...]]:
    """Odometry with the IMU's roll and pitch, if it has none of its own; heading and place stay odometry's.

    What the IMU always shows is how it is mounted: roll and pitch are taken from their middle over the log.

    Args:
      odometry: odom_from_base.
      imu: world_from_imu, without a place; z of the world is up (REP 103).
      frame: the IMU's.
      tree: the log's frames.
      base: the base's frame; None where the mount is not known.

    Returns:
      The odometry, and notes.
    """
    if spread_deg(odometry.poses) >= LEAST_DEG:
        return odometry, (f"{imu.path}: not used, as odometry has roll and pitch itself",)
    base = base or tree.base(frame) or frame
    if base != frame and tree.chain(frame, base) is None:
        return odometry, (f"{imu.path}: not used, as its frame {frame!r} is not joined with {base} in tf",)
    if not len(imu.timestamps):
        return odometry, (f"{imu.path}: not used, as none of its orientations is a rotation",)
    at, known = poses_at(imu, odometry.timestamps, 0.0, MAX_GAP_S)
    if known.mean() < LEAST_COVERED:
        return odometry, (
            f"{imu.path}: not used, as {known.sum()} of {len(known)} poses of the odometry lie between two samples at "
            f"most {MAX_GAP_S:g} s apart",
        )
    imu_from_base = np.eye(4) if base == frame else tree.at(frame, base, odometry.timestamps[known][:1])[0]
    if not np.isfinite(imu_from_base).all():
        return odometry, (f"{imu.path}: not used, as tf has no transform from {base} to {frame} at its times",)
    level = levels_from_usual((at[known] @ imu_from_base)[:, 2, :3])
    if spread_deg(level) < LEAST_DEG:
        return odometry, (f"{imu.path}: not used, as its roll and pitch never change",)
    poses = odometry.poses.copy()
    heading = turned(2, headings(poses[known]))
    poses[known, :3, :3] = (heading @ level)[:, :3, :3]
    return Trajectory(odometry.timestamps, poses, odometry.path), (f"{imu.path}: odometry has its roll and pitch",)
