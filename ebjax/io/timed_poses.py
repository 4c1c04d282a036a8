"""A trajectory at other times than its own: constant twist between samples, and a little beyond its ends."""

import numpy as np
from jaxtyping import Bool, Float, Int

from ebjax.io.clocks import time_range
from ebjax.io.poses import interpolate
from ebjax.io.trajectory import Trajectory

MAX_GAP_S = 2.0
MAX_BEYOND_S = 1.0
TWIST_S = 0.2


def nearest(times: Float[np.ndarray, " N"], queries: Float[np.ndarray, " M"]) -> Int[np.ndarray, " M"]:
    """Returns for each query the index of the nearest of the sorted times; there must be at least one."""
    after = np.clip(np.searchsorted(times, queries), 1, max(len(times) - 1, 1))
    if len(times) == 1:
        return np.zeros(len(queries), dtype=np.int64)
    return after - (queries - times[after - 1] <= times[after] - queries)


def poses_at(
    trajectory: Trajectory, times: Float[np.ndarray, " M"], max_time_difference_s: float, max_gap_s: float = MAX_GAP_S
) -> tuple[Float[np.ndarray, "M 4 4"], Bool[np.ndarray, " M"]]:
    """Evaluates a trajectory at given times, at a constant twist between its samples.

    Args:
      trajectory: timed poses.
      times: s.
      max_time_difference_s: how far the nearest sample may be where interpolation is not possible.
      max_gap_s: how far apart the two samples around a time may be to interpolate between them.

    Returns:
      The poses, NaN where there is none, and which there are.
    """
    stamps, poses = trajectory.timestamps, trajectory.poses
    closest = nearest(stamps, times)
    found = np.abs(stamps[closest] - times) <= max_time_difference_s
    result = np.where(found[:, None, None], poses[closest], np.nan)
    after = np.searchsorted(stamps, times, side="right")
    inside = np.flatnonzero((after > 0) & (after < len(stamps)))
    before, after = after[inside] - 1, after[inside]
    gap = stamps[after] - stamps[before]
    between = gap <= max_gap_s
    inside, before, after, gap = inside[between], before[between], after[between], gap[between]
    result[inside] = interpolate(poses[before], poses[after], (times[inside] - stamps[before]) / gap)
    found[inside] = True
    return result, found


def poses_everywhere(
    trajectory: Trajectory, times: Float[np.ndarray, " M"], max_beyond_s: float = MAX_BEYOND_S
) -> Float[np.ndarray, "M 4 4"]:
    """Evaluates a trajectory at every time: between samples however far apart, and beyond its ends.

    Beyond an end the twist of its last 0.2 s (two samples at least) goes on.

    Args:
      trajectory: timed poses.
      times: s.
      max_beyond_s: how far outside the trajectory a time may be.

    Raises:
      ValueError: a time further outside; names the file.
    """
    stamps, poses = trajectory.timestamps, trajectory.poses
    beyond = np.maximum(stamps[0] - times, times - stamps[-1])
    if (beyond > max_beyond_s).any():
        raise ValueError(
            f"{trajectory.path}: {(beyond > max_beyond_s).sum()} frames lie more than {max_beyond_s:g} s outside its "
            f"{time_range(stamps)}, up to {beyond.max():.3f} s; use a smaller time offset"
        )
    if len(stamps) == 1:
        return np.repeat(poses, len(times), axis=0)
    after = np.clip(np.searchsorted(stamps, times, side="right"), 1, len(stamps) - 1)
    before = after - 1
    # The ends' own samples may be close together: the twist over them would be noise.
    before = np.where(times > stamps[-1], max(np.searchsorted(stamps, stamps[-1] - TWIST_S, "right") - 1, 0), before)
    after = np.where(
        times < stamps[0], min(np.searchsorted(stamps, stamps[0] + TWIST_S, "left"), len(stamps) - 1), after
    )
    share = (times - stamps[before]) / (stamps[after] - stamps[before])
    return interpolate(poses[before], poses[after], share)


def spacing(trajectory: Trajectory) -> str:
    """Says in a few words when a trajectory's samples are, how far apart, and how long its largest gap is."""
    stamps = trajectory.timestamps
    if len(stamps) == 1:
        return f"Its one sample is at {time_range(stamps)}"
    gaps = np.diff(stamps)
    return (
        f"Its samples lie {np.median(gaps):.3g} s apart (median; the largest gap is {gaps.max():.3g} s), "
        f"from {time_range(stamps)}"
    )
