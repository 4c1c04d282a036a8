"""Trajectories of the base: from an odometry or pose topic, or from tf's odom frame."""

import numpy as np

from ebjax.io.logs.ros_poses import PoseSamples
from ebjax.io.logs.ros_tf import BASES, Pair, TfTree
from ebjax.io.trajectory import Trajectory

ODOM = ("odom", "odom_combined")


def trajectory_of_base(
    samples: PoseSamples, frames: Pair, tree: TfTree, base: str | None, *, name: str, by_receipt: bool
) -> tuple[Trajectory | None, tuple[str, ...]]:
    """The poses of a topic, moved from its child frame to the base by tf.

    Args:
      samples: the topic's.
      frames: its parent and child frame; the child is "" where the type has none.
      tree: the log's frames.
      base: the base's frame; None where the mount is not known.
      name: of the topic, for messages.
      by_receipt: whether the log's times are those of receipt.

    Returns:
      The trajectory, None where no pose is valid, and notes.
    """
    trajectory, notes = samples.trajectory(name, by_receipt)
    if not len(trajectory.timestamps):
        return None, notes
    child, base = frames[1], base or tree.base(frames[1]) or frames[1]
    if child == base:
        return trajectory, notes
    if not child or tree.chain(child, base) is None:
        is_known = child.rsplit("/", 1)[-1] in BASES
        what = f"its frame {child!r} is not joined with {base} in tf" if child else "it names no moving frame"
        return trajectory, notes if is_known and not base else (
            *notes,
            f"{name}: {what}; taken as that of {base or 'the base'}",
        )
    child_from_base = tree.at(child, base, trajectory.timestamps)
    known = np.isfinite(child_from_base).all(axis=(1, 2))
    if not known.any():
        return None, (*notes, f"{name}: tf has no transform from {base} to {child} at the time of any pose")
    if not known.all():
        notes += (f"{name}: {(~known).sum()} poses without a transform from {base} to {child} are left out",)
    notes += (f"{name}: poses of {child}, moved to {base} by tf",)
    return Trajectory(trajectory.timestamps[known], trajectory.poses[known] @ child_from_base[known], name), notes


def odometry_from_tf(tree: TfTree, base: str | None, name: str) -> tuple[Trajectory | None, tuple[str, ...]]:
    """odom_from_base at the times of tf's own samples; None where tf has no odom frame that moves."""
    odoms = sorted(frame for frame in tree.frames if frame.rsplit("/", 1)[-1] in ODOM)
    for odom in odoms:
        moving = base or tree.base(odom)
        if moving is None:
            continue
        times = tree.times(odom, moving)
        poses = tree.at(odom, moving, times)
        known = np.isfinite(poses).all(axis=(1, 2))
        if known.any():
            note = f"{name}: odometry from tf, {odom} to {moving}, {known.sum()} poses"
            return Trajectory(times[known], poses[known], name), (note,)
    return None, ()
