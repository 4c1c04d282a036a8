"""A keyframe as the engine keeps it, told in the rows of the map's file that other programs read."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ebjax.features.verify_pairs import stacked
from ebjax.geometry.planar import between, inverse, inverse_covariance
from ebjax.io.map_file.rows import EdgeRow, FrameRow, KeyframeRow
from ebjax.mapping.contents import CLOSURE, STEP
from ebjax.odometry.floor_steps import more_certain
from ebjax.slam.packed import Arrays
from ebjax.slam.store import Between
from ebjax.slam.told import unpacked_pairs

EDGES = 1 << 16
"""Room for so many edges a keyframe: those to earlier ones are numbered from EDGES times its own number on."""
UNDECIDED = "not thought over yet"
MEASURED, CARRIED = "used", "nothing measured it: carried on at the last speed"


def keyframe_row(number: int, session: int, name: str, kept: Arrays) -> KeyframeRow:
    """The keyframe, where it was thought to be when it came."""
    return KeyframeRow(number, session, int(kept["at.frame"]), float(kept["at.stamp_s"]), name, kept["at.pose"])


def step_row(number: int, before: int, pose_before: Float[np.ndarray, "3"], kept: Arrays) -> EdgeRow:
    """The step from the keyframe before.

    Args:
      number: of the keyframe.
      before: number of the one before.
      pose_before: where that was thought to be.
      kept: of the keyframe, numbers as in the file.
    """
    step = between(pose_before, kept["at.pose"])
    mine = np.flatnonzero((kept["pairs.j"] == before) & ~kept["pairs.opposing"])
    inliers, matches = kept["pairs.counts"][mine[0]].tolist() if len(mine) else (0, 0)
    measured = bool(kept["at.measured"])
    return EdgeRow(
        *(EDGES * number, STEP, number, before, False, measured, MEASURED if measured else CARRIED, inverse(step)),
        *(inverse_covariance(step, kept["at.step"]), inliers, matches),
    )


def closure_rows(number: int, kept: Arrays) -> list[EdgeRow]:
    """A closure for every candidate of a keyframe, as far as it is known when that comes."""
    told = unpacked_pairs(kept)
    rows: list[EdgeRow] = []
    for (j, opposing), distance in zip(kept["candidates"].tolist(), kept["candidates.distance"].tolist(), strict=True):
        pair = told[j, bool(opposing)]
        (pose,), (spread,), _ = more_certain(stacked([pair.settled]), False)
        edge, ends = EDGES * number + 1 + len(rows), (number, j, bool(opposing))
        rows.append(EdgeRow(edge, CLOSURE, *ends, False, UNDECIDED, pose, spread, pair.inliers, pair.total, distance))
    return rows


def frame_rows(between: Sequence[Between], keyframe: int) -> list[FrameRow]:
    """Frames that a keyframe places."""
    return [FrameRow(one.frame, one.stamp_s, one.name, keyframe, one.keyframe_from_base) for one in between]
