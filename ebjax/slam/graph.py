"""The pose graph while the robot drives: the path's steps and the closures that are believed."""

import numpy as np
from jaxtyping import Float, Int

from ebjax.geometry.planar import between
from ebjax.posegraph.graph import PoseGraph, make_graph
from ebjax.slam.measured import Measured


def graph_so_far(
    path: Float[np.ndarray, "N 3"],
    steps: Float[np.ndarray, "M 3 3"],
    piece: Int[np.ndarray, " N"],
    start: Float[np.ndarray, "N 3"],
    closures: Measured,
) -> PoseGraph:
    """The graph; the robust kernel applies to closures only.

    Args:
      path: the keyframes by their steps alone.
      steps: covariance of each step, right tangent.
      piece: of path, of each keyframe; there is no step from one to the next.
      start: where the keyframes are thought to be.
      closures: that are believed; i and j are rows of the keyframes.
    """
    rows = np.flatnonzero(np.diff(piece) == 0)
    measured = np.concatenate([between(path[rows], path[rows + 1]), closures.i_from_j])
    information = np.linalg.inv(np.concatenate([steps[rows], closures.covariance]))
    i, j = np.concatenate([rows, closures.i]), np.concatenate([rows + 1, closures.j])
    robust = np.arange(len(i)) >= len(rows)
    return make_graph(start.copy(), i, j, measured, information, robust=robust)
