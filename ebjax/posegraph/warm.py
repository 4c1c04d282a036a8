"""Makes the programs of graphs to come, before there is one so large."""

import numpy as np

from ebjax.geometry.lie import GROUPS
from ebjax.posegraph.capacity import room_for
from ebjax.posegraph.consistency import consistent_set
from ebjax.posegraph.graph import make_graph
from ebjax.posegraph.lm import cut_off, solve
from ebjax.posegraph.marginals import marginals

_POSES = 8


def compile_for(rows: int, edges: int, closures: int, *, kernel: str = "consensus", group: str = "se2") -> None:
    """Compiles what a graph of so many rows and edges, and so many closures among these, is going to need.

    That is `solve`, `cut_off`, `marginals`, `relative_marginals` and `consistent_set` at their capacities, for one
    kernel and float64; what is compiled or in JAX's cache already takes no time. May run in a thread.
    """
    lie, rng = GROUPS[group], np.random.default_rng(0)
    chain, x = np.arange(_POSES - 1), -3 if group == "se3" else 0
    i, j = np.append(chain, [_POSES - 1, _POSES - 2]), np.append(chain + 1, [0, 1])
    poses, measured = np.tile(lie.identity, (_POSES, 1)), np.tile(lie.identity, (len(i), 1))
    poses[:, x] = np.arange(_POSES) + 1e-3 * rng.normal(size=_POSES)
    measured[:, x] = j - i
    information = np.tile(1e4 * np.eye(lie.dim), (len(i), 1, 1))
    graph = make_graph(poses, i, j, measured, information, robust=i > j)
    loops = slice(len(chain), None)
    spread = np.linalg.inv(information)
    with room_for(rows, edges, closures):
        solve(graph, kernel=kernel)
        cut_off(graph, poses, kernel=kernel)
        marginals(graph, np.array([1]), kernel=kernel)
        consistent_set(poses, spread[: len(chain)], i[loops], j[loops], measured[loops], spread[loops], np.ones(2))
