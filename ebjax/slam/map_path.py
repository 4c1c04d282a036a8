"""The path of a run behind the keyframes of the runs before it in a map, and the graph of all of them."""

import dataclasses

import numpy as np

from ebjax.geometry.planar import between
from ebjax.posegraph.graph import PoseGraph, make_graph
from ebjax.slam.engine import Engine
from ebjax.slam.join import joined
from ebjax.slam.measured import Measured
from ebjax.slam.path import SYSTEMATIC, Path
from ebjax.slam.walked import Walked


class MapPath:
    """The keyframes of earlier runs, and behind them the nodes of a run's path.

    Attributes:
      walked: all of them, as candidates are compared with it.
      in_map: whether the closures of the last graph join the run to the earlier ones; True where there are none.
    """

    def __init__(self, engine: Engine, path: Path):
        self._start, self._path = engine.start, path
        self._node = engine.start + np.searchsorted(path.frames, engine.numbers)
        self._earlier = engine.chain.covariance[: max(engine.start - 1, 0)]
        self.in_map = True
        steps = engine.chain.steps[1 : engine.start + 1] if engine.start else np.zeros((0, 3, 3))
        self.walked = Walked(
            np.concatenate([engine.chain.poses[: engine.start], path.poses]),
            np.concatenate([SYSTEMATIC * steps, path.covariance]),
            np.concatenate([
                engine.keyframes.piece[: engine.start], np.full(len(path.poses), engine.store.current)
            ]),
        )  # fmt: skip

    def nodes_of(self, rows: Measured) -> Measured:
        """Candidates between nodes in place of keyframes."""
        node = np.concatenate([np.arange(self._start), self._node])
        return dataclasses.replace(rows, i=node[rows.i], j=node[rows.j])

    def graph(self, closures: Measured) -> PoseGraph:
        """Earlier runs' steps, the run's own, and closures between nodes; the kernel applies to closures only."""
        walked, edges, start = self.walked, self._path.edges, self._start
        poses = walked.poses
        if start:
            poses, done = joined(poses, walked.piece, closures)
            self.in_map = bool(done[start])
        rows = np.flatnonzero(np.diff(walked.piece[:start]) == 0)
        between_rows = between(walked.poses[rows], walked.poses[rows + 1])
        steps = np.linalg.inv(self._earlier[rows]), edges.information, np.linalg.inv(closures.covariance)
        ties = len(rows) + len(edges.i)
        return make_graph(
            poses.astype(np.float64),
            np.concatenate([rows, edges.i + start, closures.i]),
            np.concatenate([rows + 1, edges.j + start, closures.j]),
            np.concatenate([between_rows, edges.measured, closures.i_from_j]).astype(np.float64),
            np.concatenate(steps).astype(np.float64),
            robust=np.arange(ties + len(closures.i)) >= ties,
        )
