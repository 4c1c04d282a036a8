"""The corrected path while the robot drives: the pose graph solved beside it, taken over a little later.

A solve is begun when the graph has grown by a 64th, and at least by four keyframes. Its answer is taken over when the
next is begun, whether it was ready long before or must be waited for: what is said never depends on how fast a machine
is. Nothing is decided by it.

A large graph is solved whole when it has grown by a 16th; in between what has come since is, the rest standing still.
"""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ebjax.geometry.planar import between, compose
from ebjax.posegraph.graph import PoseGraph, make_graph
from ebjax.posegraph.lm import solve
from ebjax.posegraph.warm import compile_solve_for
from ebjax.slam.pauses import brief_turns

SHARE, LEAST = 64, 4
LARGE, WHOLE = 1024, 16
"""Keyframes of a graph that is solved whole only when it has grown by a WHOLEth."""
STEPS, RTOL = 20, 1e-3
"""Of a solve: it ends where a step gains less than that share; at the end of a run the graph is solved to the end."""
SOLVER = "qdldl"
"""Lets Python run while it factorises, as CHOLMOD does not: the robot would wait."""
FIRST = 256
"""Rows of the smallest graph program."""

Begin = Callable[[Float[np.ndarray, "N 3"]], tuple[PoseGraph, Bool[np.ndarray, " N"]]]
"""(where the keyframes are thought to be) -> the graph, and which of them are in the map's frame; runs in a thread."""


class Corrected(NamedTuple):
    """What a solve said: poses, and which of them are in the map's frame."""

    poses: Float[np.ndarray, "n 3"]
    in_map: Bool[np.ndarray, " n"]


class Corrector:
    """Where the keyframes are after the closures.

    Args:
      most: keyframes that there will be at most; None: not known.
    """

    def __init__(self, most: int | None = None):
        self._most = most
        self._pool = ThreadPoolExecutor(1)
        self._beside = ThreadPoolExecutor(1)
        self._compiled = FIRST
        self._waiting: Future[Corrected] | None = None
        self._begun = self._whole = 0
        self._settled = Corrected(np.zeros((0, 3)), np.zeros(0, bool))

    def take(self, rows: int, graph: Callable[[], Begin], path: Float[np.ndarray, "N 3"]) -> bool:
        """Takes over what was begun and begins anew, if it is time; returns whether the path was corrected.

        Args:
          rows: keyframes so far.
          graph: holds what the graph is to be made of; not asked before it is time.
          path: before any closure.
        """
        if rows - self._begun < max(LEAST, rows // SHARE):
            return False
        taken = self._waiting is not None
        if self._waiting is not None:
            self._settled = self._waiting.result()
        self._begun = rows
        if 2 * rows > self._compiled and (self._most is None or self._most > self._compiled):
            # At half its capacity: the programs of larger graphs are ready when they are needed.
            self._compiled *= 2
            self._beside.submit(_compiled, self._compiled)
        if rows <= LARGE or rows - self._whole >= rows // WHOLE:
            self._whole, first = rows, 0
        else:
            first = self._whole
        self._waiting = self._pool.submit(_solved, graph(), self.poses(path), first)
        return taken

    def poses(self, path: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """Of all keyframes: as they were settled, the later ones carried on by the path's steps."""
        done = self.settled
        if not done:
            return path.copy()
        shape = path[done:].shape
        steps = between(np.broadcast_to(path[done - 1], shape), path[done:])
        carried = compose(np.broadcast_to(self._settled.poses[-1], shape), steps)
        return np.concatenate([self._settled.poses, carried])

    def last(self, path: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "3"]:
        """Of the last keyframe."""
        done = self.settled
        return path[-1].copy() if not done else compose(self._settled.poses[-1], between(path[done - 1], path[-1]))

    @property
    def settled(self) -> int:
        """How many keyframes the last correction had."""
        return len(self._settled.poses)

    def in_map(self, row: int) -> bool:
        """Whether the last correction had a keyframe in the map's frame."""
        return row < self.settled and bool(self._settled.in_map[row])

    def close(self) -> None:
        """Waits for what was begun."""
        self._pool.shutdown()
        self._beside.shutdown(cancel_futures=True)


def _compiled(rows: int) -> None:
    with brief_turns():
        compile_solve_for(rows)


def _solved(graph: Begin, thought: Float[np.ndarray, "N 3"], first: int) -> Corrected:
    whole, in_map = graph(thought)
    part, rows = touching(whole, first)
    poses = np.array(whole.poses)
    poses[rows] = solve(part, max_steps=STEPS, rtol=RTOL, solver=SOLVER).poses
    return Corrected(poses, in_map)


def touching(graph: PoseGraph, first: int) -> tuple[PoseGraph, Int[np.ndarray, " K"]]:
    """The edges that touch rows from `first` on, the rows before it standing still; and which rows they are."""
    edges = np.flatnonzero((graph.i >= first) | (graph.j >= first))
    rows, ends = np.unique(np.concatenate([graph.i[edges], graph.j[edges]]), return_inverse=True)
    i, j = ends.reshape(2, -1)
    kept = (field[edges] for field in (graph.measured, graph.information))
    return make_graph(graph.poses[rows], i, j, *kept, robust=graph.robust[edges], fixed=rows < first), rows
