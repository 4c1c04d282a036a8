"""Makes the programs of graphs to come, before there is one so large."""

import numpy as np

from ebjax.geometry.lie import GROUPS
from ebjax.posegraph.capacity import room_for
from ebjax.posegraph.graph import PoseGraph, make_graph
from ebjax.posegraph.lm import solve

_POSES = 8


def compile_solve_for(rows: int, *, kernel: str = "cauchy", group: str = "se2") -> None:
    """Compiles what `solve` of a graph of so many rows, and up to twice as many edges, is going to need.

    For one kernel and float64; what is compiled or in JAX's cache already takes little time. May run in a thread.
    """
    graph = _small(group)
    with room_for(rows, 2 * rows):
        solve(graph, kernel=kernel)


def _small(group: str) -> PoseGraph:
    lie, rng = GROUPS[group], np.random.default_rng(0)
    chain, x = np.arange(_POSES - 1), -3 if group == "se3" else 0
    i, j = np.append(chain, [_POSES - 1, _POSES - 2]), np.append(chain + 1, [0, 1])
    poses, measured = np.tile(lie.identity, (_POSES, 1)), np.tile(lie.identity, (len(i), 1))
    poses[:, x] = np.arange(_POSES) + 1e-3 * rng.normal(size=_POSES)
    measured[:, x] = j - i
    information = np.tile(1e4 * np.eye(lie.dim), (len(i), 1, 1))
    return make_graph(poses, i, j, measured, information, robust=i > j)
