"""Pieces of path brought into one frame by the closures between them: a robot that was switched off, or carried."""

import numpy as np
from jaxtyping import Bool, Float, Int

from ebjax.geometry.planar import between, compose, inverse
from ebjax.slam.measured import Measured


def joined(
    poses: Float[np.ndarray, "N 3"], piece: Int[np.ndarray, " N"], closures: Measured
) -> tuple[Float[np.ndarray, "N 3"], Bool[np.ndarray, " N"]]:
    """The poses, every piece that closures join moved as a whole into the frame of the first; and which are in it.

    Args:
      poses: x, y (m), heading (rad) of keyframes, each piece in a frame of its own.
      piece: of every keyframe.
      closures: that are believed; i and j are rows of the poses.
    """
    poses = poses.copy()
    done = piece == piece[0]
    while True:
        ahead = done[closures.i] != done[closures.j]
        if not ahead.any():
            return poses, done
        some = closures.rows(np.flatnonzero(ahead))
        there = np.where(done[some.i], some.j, some.i)
        pieces, counts = np.unique(piece[there], return_counts=True)
        chosen = pieces[np.argmax(counts)]
        mine = piece[there] == chosen
        map_from_piece = _most_agreed(*_ends(poses, done, some.rows(np.flatnonzero(mine))))
        rows = piece == chosen
        poses[rows] = compose(np.broadcast_to(map_from_piece, poses[rows].shape), poses[rows])
        done |= rows


def _ends(
    poses: Float[np.ndarray, "N 3"], done: Bool[np.ndarray, " N"], closures: Measured
) -> tuple[Float[np.ndarray, "K 3"], Float[np.ndarray, "K 3"]]:
    """Of every closure the end in the new piece: where the map says it is, and where its own piece does."""
    known = done[closures.i]
    by_i = compose(poses[closures.i], closures.i_from_j)
    by_j = compose(poses[closures.j], inverse(closures.i_from_j))
    return np.where(known[:, None], by_i, by_j), poses[np.where(known, closures.j, closures.i)]


def _most_agreed(there: Float[np.ndarray, "K 3"], own: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "3"]:
    """The map_from_piece of that closure which the others agree with best."""
    moves = compose(there, inverse(own))
    off = np.empty(len(moves))
    for k, move in enumerate(moves):
        apart = between(there, compose(np.broadcast_to(move, own.shape), own))
        off[k] = np.median(np.hypot(apart[:, 0], apart[:, 1]) + np.abs(apart[:, 2]))
    return moves[np.argmin(off)]
