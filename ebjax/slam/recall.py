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


def worth_verifying(
    alike: Alike, row: int, path: Walked, view: RunView, config: PipelineConfig, either_way: bool = False
) -> Alike:
    """The first `config.verify` of each direction that odometry does not rule out.

    Args:
      alike: the ranking of all.
      row: of the keyframe.
      path: of the keyframes.
      view: of the run.
      config: how many are verified, and how far odometry may err.
      either_way: local features do not change with orientation, so that a pair that is taken to face the wrong way can
        be verified all the same.
    """
    i = np.full(len(alike.j), row)
    known = path.piece[alike.j] == path.piece[row]
    good = ~known
    sigmas = config.believe.odometry_sigmas
    where = path.poses, view.centre_m, view.extent_m, path.steps
    claimed = None if either_way else alike.opposing[known]
    good[known] = plausible(i[known], alike.j[known], claimed, *where, sigmas)
    return best_of_each_way(alike, good, config.verify)


def not_ranked(
    chosen: Alike, row: int, comparable: tuple[int, int], path: Walked, view: RunView, config: PipelineConfig
) -> tuple[Bool[np.ndarray, " N"], Bool[np.ndarray, " N"]]:
    """Which rows odometry allows beside the chosen ones, in each direction that has fewer than `config.verify` of them.

    Where many places look alike, the first of a ranking of all may be none that the robot can be at. Between two pieces
    of path nothing is known, and the ranking of all is the only one.

    Args:
      chosen: by `worth_verifying`.
      row: of the keyframe.
      comparable: how many of the first rows may be compared in the same direction, and in the opposite one.
      path: of the keyframes.
      view: of the run.
      config: how many are verified, and how far odometry may err.
    """
    masks = np.zeros((2, row), bool)
    for way, count in enumerate(comparable):
        mine = chosen.j[chosen.opposing == bool(way)]
        if len(mine) < config.verify:
            rows = np.flatnonzero(path.piece[:count] == path.piece[row])
            where = path.poses, view.centre_m, view.extent_m, path.steps, config.believe.odometry_sigmas
            allowed = plausible(np.full(len(rows), row), rows, np.full(len(rows), bool(way)), *where)
            masks[way, rows[allowed]] = True
            masks[way, mine] = False
    return masks[0], masks[1]


def best_of_each_way(alike: Alike, good: Bool[np.ndarray, " K"], count: int) -> Alike:
    """The first `count` of each direction among those that are good."""
    chosen = np.zeros(len(alike.j), bool)
    for way in (False, True):
        mine = good & (alike.opposing == way)
        chosen |= mine & (np.cumsum(mine) <= count)
    return Alike(alike.j[chosen], alike.opposing[chosen], alike.distance[chosen])


def filled(chosen: Alike, others: Alike, count: int) -> Alike:
    """The chosen ones, and of each direction the best others until there are `count`."""
    pairs = zip(dataclasses.astuple(chosen), dataclasses.astuple(others), strict=True)
    every = Alike(*(np.concatenate(two) for two in pairs))
    return best_of_each_way(every, np.ones(len(every.j), bool), count)
