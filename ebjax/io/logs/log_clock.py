"""One unit of time for all of a log: images, depth images, odometry and ground truth may come from several writers."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ebjax.io.clocks import in_seconds, trajectory_in_seconds, unit_note
from ebjax.io.logs.log import Log
from ebjax.io.trajectory import Trajectory


def log_in_seconds(log: Log, time_offset_s: float = 0.0) -> Log:
    """Converts what is recognised as milliseconds, microseconds or nanoseconds, and notes it.

    Dates speak for themselves; other clocks are recognised beside a part of the log that is in seconds.

    Args:
      log: any; one of fewer than two images stays as it is.
      time_offset_s: added to the images' stamps before they are compared with poses.
    """
    if len(log.colour) < 2:
        return log
    stamps = log.colour.timestamps
    odometry, notes = _converted(log.odometry, None)
    truth, said = _converted(log.truth, None)
    notes += said
    beside = [poses.timestamps - time_offset_s for poses in (odometry, truth) if poses is not None]
    for others in (None, *beside):
        stamps, unit = in_seconds(stamps, others)
        if unit is not None:
            notes += (unit_note(log.colour.source, unit),)
            break
    odometry, said = _converted(odometry, stamps + time_offset_s)
    notes += said
    truth, said = _converted(truth, stamps + time_offset_s)
    notes += said
    depth = log.depth
    if depth is not None and len(depth):
        times, unit = in_seconds(depth.timestamps, stamps)
        if unit is not None:
            depth = replace(depth, timestamps=times)
            notes += (unit_note(depth.source, unit),)
    if not notes:
        return log
    colour = replace(log.colour, timestamps=stamps)
    return replace(log, colour=colour, depth=depth, odometry=odometry, truth=truth, notes=(*log.notes, *notes))


def _converted(
    trajectory: Trajectory | None, others: Float[np.ndarray, " N"] | None
) -> tuple[Trajectory | None, tuple[str, ...]]:
    return (None, ()) if trajectory is None else trajectory_in_seconds(trajectory, others)
