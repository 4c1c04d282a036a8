"""Which earlier keyframes a keyframe is verified against: alike by their places, and not ruled out by odometry."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int

from ebjax.slam.config import PipelineConfig
from ebjax.slam.gate import plausible
from ebjax.slam.walked import Walked
from ebjax.views.run_view import RunView


@dataclasses.dataclass(frozen=True)
class Alike:
    """Earlier keyframes that look alike, best first: rows, directions, distances of the descriptors."""

    j: Int[np.ndarray, " K"]
    opposing: Bool[np.ndarray, " K"]
    distance: Float[np.ndarray, " K"]


def comparable_rows(
    stamps: Float[np.ndarray, " N"], travelled: Float[np.ndarray, " N"], start: int, gap_s: float, gap_m: float
) -> tuple[int, int]:
    """How many of the first rows the last may be compared with, in the same direction and in the opposite one.

    Both leave out a time gap. The same direction also leaves out a travelled distance: until then the views overlap
    because the robot has hardly moved, which odometry knows better.

    Args:
      stamps: of the keyframes, s.
      travelled: the way to each, m.
      start: where the last one's own piece of path begins; all rows before are comparable.
      gap_s: see `PipelineConfig.min_gap_s`.
      gap_m: see `PipelineConfig.min_gap_m`.
    """
    last = len(stamps) - 1
    opposing = int(np.searchsorted(stamps[start:last], stamps[last] - gap_s, side="right"))
    moved = int(np.searchsorted(travelled[start:last], travelled[last] - gap_m, side="right"))
    return start + min(opposing, moved), start + opposing


def worth_verifying(alike: Alike, row: int, path: Walked, view: RunView, config: PipelineConfig) -> Alike:
    """The first `config.verify` of each direction that odometry does not rule out."""
    i = np.full(len(alike.j), row)
    known = path.piece[alike.j] == path.piece[row]
    good = ~known
    sigmas = config.believe.odometry_sigmas
    good[known] = plausible(i[known], alike.j[known], path.poses, view.centre_m, view.extent_m, path.steps, sigmas)
    return best_of_each_way(alike, good, config.verify)


def best_of_each_way(alike: Alike, good: Bool[np.ndarray, " K"], count: int) -> Alike:
    """The first `count` of each direction among those that are good."""
    chosen = np.zeros(len(alike.j), bool)
    for way in (False, True):
        mine = good & (alike.opposing == way)
        chosen |= mine & (np.cumsum(mine) <= count)
    return Alike(alike.j[chosen], alike.opposing[chosen], alike.distance[chosen])
