"""The pose graph: poses, relative measurements between them, and which poses stay where they are.

Row k of the edges says: poses[j_k] seen from poses[i_k] is measured_k, i_from_j, with information (inverse covariance)
in the tangent order of `ebjax.geometry.lie`: (x, y, theta) or (x, y, z, wx, wy, wz), m and rad.
"""

from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ebjax.geometry.lie import GROUPS, Group


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PoseGraph:
    """A pose graph over SE(2), poses (x, y, theta), or SE(3), poses (qw, qx, qy, qz, x, y, z).

    Attributes:
      poses: world_from_base, the starting point of `solve`.
      i: row of the pose an edge is measured in.
      j: row of the pose an edge measures.
      measured: i_from_j.
      information: inverse covariance of log(measured^-1 * i_from_j), symmetric.
      robust: whether the robust kernel applies to the edge.
      fixed: poses that do not move.
      group: "se2" or "se3".
    """

    poses: Float[Array | np.ndarray, "N P"]
    i: Int[Array | np.ndarray, " E"]
    j: Int[Array | np.ndarray, " E"]
    measured: Float[Array | np.ndarray, "E P"]
    information: Float[Array | np.ndarray, "E d d"]
    robust: Bool[Array | np.ndarray, " E"]
    fixed: Bool[Array | np.ndarray, " N"]
    group: str = field(default="se2", metadata=dict(static=True))

    @property
    def lie(self) -> Group:
        """The group's functions."""
        return GROUPS[self.group]


def make_graph(
    poses: Float[Array | np.ndarray, "N P"],
    i: Int[Array | np.ndarray, " E"],
    j: Int[Array | np.ndarray, " E"],
    measured: Float[Array | np.ndarray, "E P"],
    information: Float[Array | np.ndarray, "E d d"],
    *,
    robust: Bool[Array | np.ndarray, " E"] | None = None,
    fixed: Bool[Array | np.ndarray, " N"] | None = None,
) -> PoseGraph:
    """Builds a graph; the group follows from the width of a pose, every edge is robust and nothing fixed by default."""
    return PoseGraph(
        poses,
        i,
        j,
        measured,
        information,
        np.ones(len(i), bool) if robust is None else robust,
        np.zeros(len(poses), bool) if fixed is None else fixed,
        "se2" if poses.shape[-1] == 3 else "se3",
    )


def add_priors(
    graph: PoseGraph,
    rows: Int[Array | np.ndarray, " K"],
    world_from_base: Float[Array | np.ndarray, "K P"],
    information: Float[Array | np.ndarray, "K d d"],
) -> PoseGraph:
    """Ties the poses `rows` to measured world poses, by edges from one more pose: the world, last and fixed.

    A prior on pose p costs r^T information r, r = log(measured^-1 * world_from_base_p), without a robust kernel. The
    pieces of the graph that have one need no fixed pose.
    """
    world, count = len(graph.poses), len(rows)
    identity = jnp.asarray(graph.lie.identity, jnp.asarray(graph.poses).dtype)[None]
    join = jnp.concatenate
    return PoseGraph(
        join([jnp.asarray(graph.poses), identity]),
        np.concatenate([np.asarray(graph.i), np.full(count, world)]),
        np.concatenate([np.asarray(graph.j), np.asarray(rows)]),
        join([jnp.asarray(graph.measured), jnp.asarray(world_from_base)]),
        join([jnp.asarray(graph.information), jnp.asarray(information)]),
        np.concatenate([np.asarray(graph.robust), np.zeros(count, bool)]),
        np.append(np.asarray(graph.fixed), True),
        graph.group,
    )


def check(graph: PoseGraph) -> None:
    """Refuses what cannot be solved, for arrays that are not being traced.

    Raises:
      ValueError: names the first offending edge or pose and the remedy.
    """
    size, dim = graph.lie.size, graph.lie.dim
    n, e = len(graph.poses), len(graph.i)
    if graph.poses.shape != (n, size) or graph.measured.shape != (e, size) or graph.information.shape != (e, dim, dim):
        raise ValueError(
            f"{graph.group} graph: poses {graph.poses.shape}, measured {graph.measured.shape}, information "
            f"{graph.information.shape}; give (N, {size}), (E, {size}), (E, {dim}, {dim})"
        )
    for name in ("poses", "measured", "information"):
        value = getattr(graph, name)
        if not isinstance(value, jax.core.Tracer):
            bad = ~np.isfinite(np.asarray(value)).all(tuple(range(1, value.ndim)))
            if bad.any():
                raise ValueError(f"{name} row {int(np.argmax(bad))} is not finite; remove the row or repair its source")
    if not isinstance(graph.information, jax.core.Tracer) and e:
        information = np.asarray(graph.information)
        lowest = np.linalg.eigvalsh((information + information.swapaxes(1, 2)) / 2)[:, 0]
        if (lowest <= 0).any():
            k = int(np.argmax(lowest <= 0))
            raise ValueError(
                f"information of edge {k} is not positive definite (eigenvalue {lowest[k]:.3g}); repair it"
            )


def anchored(graph: PoseGraph) -> PoseGraph:
    """Fixes the first pose of every connected component that has no fixed pose: the gauge.

    A graph in several pieces is thereby solved piece by piece, each where its first pose stands. `i`, `j` and `fixed`
    must be concrete.
    """
    fixed = np.array(graph.fixed)
    label = components(len(fixed), np.asarray(graph.i), np.asarray(graph.j))
    for piece in np.unique(label):
        members = np.flatnonzero(label == piece)
        if not fixed[members].any():
            fixed[members[0]] = True
    return replace(graph, fixed=fixed)


def components(n: int, i: Int[np.ndarray, " E"], j: Int[np.ndarray, " E"]) -> Int[np.ndarray, " N"]:
    """Connected component of every pose, by repeated minimum over edges and pointer jumping."""
    label = np.arange(n)
    while True:
        low = np.minimum(label[i], label[j])
        new = label.copy()
        np.minimum.at(new, label[i], low)
        np.minimum.at(new, label[j], low)
        new = new[new]
        while not np.array_equal(new, new[new]):
            new = new[new]
        if np.array_equal(new, label):
            return label
        label = new
