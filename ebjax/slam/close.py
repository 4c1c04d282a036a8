"""The loops of a path closed: which of the measured candidates it believes, and the pose graph that they make."""

import time
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ebjax.posegraph.graph import PoseGraph
from ebjax.posegraph.levenberg import Solution
from ebjax.posegraph.lm import cut_off, solve
from ebjax.slam.believe import CONTRADICTED, Belief
from ebjax.slam.engine import Engine
from ebjax.slam.map_path import MapPath
from ebjax.slam.measured import Measured
from ebjax.slam.path import Path
from ebjax.slam.run import Earlier


class Closed(NamedTuple):
    """A path whose loops are closed.

    Attributes:
      graph: the path and the kept closures.
      solution: its optimum.
      poses: of all frames: x, y (m), heading (rad).
      earlier: of the map it was driven in.
    """

    graph: PoseGraph
    solution: Solution
    poses: Float[np.ndarray, "F 3"]
    earlier: Earlier


def close(engine: Engine, path: Path, every: Measured) -> Closed:
    """The closures among measured candidates that a path believes, and what they make of it.

    Args:
      engine: whose keyframes lie on the path.
      path: of the engine's own run.
      every: candidates of all runs; i and j are rows of all keyframes.
    """
    begun, config = time.perf_counter(), engine.config
    map_path = MapPath(engine, path)
    belief = Belief(config.believe)
    belief.update(map_path.nodes_of(every), map_path.walked)
    engine.seconds["believe"] = engine.seconds.get("believe", 0.0) + time.perf_counter() - begun

    begun = time.perf_counter()
    kept = np.flatnonzero(belief.kept)
    graph = map_path.graph(map_path.nodes_of(every.rows(kept)))
    solution = solve(graph, kernel=config.kernel, width=config.kernel_width, max_steps=100)
    cut = cut_off(graph, solution.poses, kernel=config.kernel, width=config.kernel_width)[-len(kept) :]
    if len(kept) and cut.any():
        belief.reasons[kept[cut]] = CONTRADICTED
        graph = map_path.graph(map_path.nodes_of(every.rows(kept[~cut])))
    solved, reasons = np.asarray(solution.poses), [str(reason) for reason in belief.reasons]
    poses = path.everywhere(solved[engine.start :])
    engine.seconds["pose graph"] = time.perf_counter() - begun
    earlier = Earlier(engine.start, solved[: engine.start], every, reasons, map_path.in_map)
    return Closed(graph, solution, poses, earlier)
