"""The corrected path while the robot drives: the pose graph solved beside it, taken over a little later.

A solve is begun when the graph has grown by a 64th, and at least by four keyframes. Its answer is taken over when the
next is begun, whether it was ready long before or must be waited for: what is said never depends on how fast a machine
is. Nothing is decided by it.
"""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from jaxtyping import Float

from ebjax.geometry.planar import between, compose
from ebjax.posegraph.graph import PoseGraph
from ebjax.posegraph.lm import solve
from ebjax.posegraph.warm import compile_solve_for

SHARE, LEAST = 64, 4
STEPS, RTOL = 20, 1e-3
"""Of a solve: it ends where a step gains less than that share; at the end of a run the graph is solved to the end."""
FIRST = 256
"""Rows of the smallest graph program."""


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
        self._waiting: Future | None = None
        self._begun = 0
        self._settled = np.zeros((0, 3))

    def take(self, rows: int, graph: Callable[[Float[np.ndarray, "N 3"]], PoseGraph], path: Float[np.ndarray, "N 3"]):
        """Takes over what was begun and begins anew, if it is time; returns whether the path was corrected.

        Args:
          rows: keyframes so far.
          graph: (where they are thought to be) -> the graph.
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
            self._beside.submit(compile_solve_for, self._compiled)
        made = graph(self.poses(path))
        self._waiting = self._pool.submit(lambda: np.asarray(solve(made, max_steps=STEPS, rtol=RTOL).poses))
        return taken

    def poses(self, path: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """Of all keyframes: as they were settled, the later ones carried on by the path's steps."""
        done = len(self._settled)
        if not done:
            return path.copy()
        shape = path[done:].shape
        steps = between(np.broadcast_to(path[done - 1], shape), path[done:])
        carried = compose(np.broadcast_to(self._settled[-1], shape), steps)
        return np.concatenate([self._settled, carried])

    def last(self, path: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "3"]:
        """Of the last keyframe."""
        done = len(self._settled)
        return path[-1].copy() if not done else compose(self._settled[-1], between(path[done - 1], path[-1]))

    @property
    def settled(self) -> int:
        """How many keyframes the last correction had."""
        return len(self._settled)

    def close(self) -> None:
        """Waits for what was begun."""
        self._pool.shutdown()
        self._beside.shutdown(cancel_futures=True)
