"""The pose graph: poses, relative measurements between them, and which poses stay where they are.

Row k of the edges says: poses[j_k] seen from poses[i_k] is measured_k, i_from_j, with information (inverse covariance)
in the tangent order of `ebjax.geometry.lie`: (x, y, theta) or (x, y, z, wx, wy, wz), m and rad. Information may be
semidefinite: a direction that a measurement says nothing of has none.

Two things more fit in the same rows. A landmark is a pose whose rotation is held at the identity. An edge marked
`position` measures where j lies, seen from i, and not how it is turned. Priors are edges from one more row, the world,
which is fixed at the identity: a full one is a prior on a pose, one marked `position` is what a GPS fix says.
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
      position: edges that measure a position only, r = R_i^T (t_j - t_i) - t_measured; None where there are none.
      landmark: rows that are points; they stand behind the poses. None where there are none.
      world: whether the last row is the world, in which priors are measured.
    """

    poses: Float[Array | np.ndarray, "N P"]
    i: Int[Array | np.ndarray, " E"]
    j: Int[Array | np.ndarray, " E"]
    measured: Float[Array | np.ndarray, "E P"]
    information: Float[Array | np.ndarray, "E d d"]
    robust: Bool[Array | np.ndarray, " E"]
    fixed: Bool[Array | np.ndarray, " N"]
    group: str = field(default="se2", metadata=dict(static=True))
    position: Bool[Array | np.ndarray, " E"] | None = None
    landmark: Bool[Array | np.ndarray, " N"] | None = None
    world: bool = field(default=False, metadata=dict(static=True))

    @property
    def lie(self) -> Group:
        """The group's functions."""
        return GROUPS[self.group]

    @property
    def pose_count(self) -> int:
        """Rows that are poses of the robot, the first ones."""
        points = 0 if self.landmark is None else int(np.sum(np.asarray(self.landmark)))
        return len(self.poses) - points - self.world


def make_graph(
    poses: Float[Array | np.ndarray, "N P"],
    i: Int[Array | np.ndarray, " E"],
    j: Int[Array | np.ndarray, " E"],
    measured: Float[Array | np.ndarray, "E P"],
    information: Float[Array | np.ndarray, "E d d"],
    *,
    robust: Bool[Array | np.ndarray, " E"] | None = None,
    fixed: Bool[Array | np.ndarray, " N"] | None = None,
    position: Bool[Array | np.ndarray, " E"] | None = None,
    landmark: Bool[Array | np.ndarray, " N"] | None = None,
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
        position,
        landmark,
    )


def add_priors(
    graph: PoseGraph,
    rows: Int[Array | np.ndarray, " K"],
    world_from_base: Float[Array | np.ndarray, "K P"],
    information: Float[Array | np.ndarray, "K d d"],
    *,
    position: Bool[Array | np.ndarray, " K"] | None = None,
    robust: Bool[Array | np.ndarray, " K"] | None = None,
) -> PoseGraph:
    """Ties the rows `rows` to measured world poses, by edges from one more row: the world, last and fixed.

    A prior on pose p costs r^T information r, r = log(measured^-1 * world_from_base_p); one marked `position` costs
    the same of r = t_p - t_measured. By default none is a position alone, and none has the robust kernel. Pieces of the
    graph that priors hold need no fixed pose.

    Args:
      graph: with priors or without.
      rows: poses or, for positions, landmarks.
      world_from_base: what was measured; of positions the rotation does not count.
      information: of positions the first rows and columns count, two or three.
      position: priors that measure a position only.
      robust: priors that the robust kernel applies to.
    """
    graph = graph if graph.world else _with_world(graph)
    world, count, join = len(graph.poses) - 1, len(rows), jnp.concatenate
    none, marks = np.zeros(count, bool), graph.position
    if marks is not None or position is not None:
        before = np.zeros(len(graph.i), bool) if marks is None else np.asarray(marks)
        marks = np.concatenate([before, none if position is None else np.asarray(position)])
    return replace(
        graph,
        i=np.concatenate([np.asarray(graph.i), np.full(count, world)]),
        j=np.concatenate([np.asarray(graph.j), np.asarray(rows)]),
        measured=join([jnp.asarray(graph.measured), jnp.asarray(world_from_base)]),
        information=join([jnp.asarray(graph.information), jnp.asarray(information)]),
        robust=np.concatenate([np.asarray(graph.robust), none if robust is None else np.asarray(robust)]),
        position=marks,
    )


def _with_world(graph: PoseGraph) -> PoseGraph:
    identity = jnp.asarray(graph.lie.identity, jnp.asarray(graph.poses).dtype)[None]
    return replace(
        graph,
        poses=jnp.concatenate([jnp.asarray(graph.poses), identity]),
        fixed=np.append(np.asarray(graph.fixed), True),
        landmark=None if graph.landmark is None else np.append(np.asarray(graph.landmark), False),
        world=True,
    )


def between_poses(graph: PoseGraph) -> Bool[np.ndarray, " E"]:
    """Edges that measure one pose of the robot from another: no priors, no landmarks, no positions alone."""
    ends: np.ndarray = np.maximum(np.asarray(graph.i), np.asarray(graph.j)) < graph.pose_count
    return ends if graph.position is None else np.asarray(ends & ~np.asarray(graph.position))


def _apart(graph: PoseGraph) -> Int[np.ndarray, " E"]:
    """By how many rows the ends of every edge differ."""
    return np.asarray(np.abs(np.asarray(graph.i) - np.asarray(graph.j)))


def steps_of(graph: PoseGraph) -> Bool[np.ndarray, " E"]:
    """Edges that join successive poses."""
    return np.asarray(between_poses(graph) & (_apart(graph) == 1))


def loops_of(graph: PoseGraph) -> Bool[np.ndarray, " E"]:
    """Edges that join poses which are not successive."""
    return np.asarray(between_poses(graph) & (_apart(graph) > 1))


def poses_alone(graph: PoseGraph) -> PoseGraph:
    """The robot's poses and the edges between them; the graph itself where there is nothing else."""
    count, kept = graph.pose_count, between_poses(graph)
    if count == len(graph.poses) and kept.all():
        return graph
    i, j, measured, information, robust = (
        np.asarray(x)[kept] for x in (graph.i, graph.j, graph.measured, graph.information, graph.robust)
    )
    poses, fixed = np.asarray(graph.poses)[:count], np.asarray(graph.fixed)[:count]
    return make_graph(poses, i, j, measured, information, robust=robust, fixed=fixed)


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
    for name, length in (("j", e), ("robust", e), ("fixed", n)):
        if (shape := np.shape(getattr(graph, name))) != (length,):
            raise ValueError(f"{graph.group} graph of {n} poses and {e} edges: {name} is {shape}; give ({length},)")
    for name in ("poses", "measured", "information"):
        value = getattr(graph, name)
        if not isinstance(value, jax.core.Tracer):
            bad = ~np.isfinite(np.asarray(value)).all(tuple(range(1, value.ndim)))
            if bad.any():
                raise ValueError(f"{name} row {int(np.argmax(bad))} is not finite; remove the row or repair its source")
    if not isinstance(graph.information, jax.core.Tracer) and e and not definite(graph.information):
        bad = negative(np.asarray(graph.information))
        if bad.any():
            k = int(np.argmax(bad))
            lowest = np.linalg.eigvalsh(np.asarray(graph.information)[k])[0]
            raise ValueError(
                f"information of edge {k} is not positive definite or semidefinite (eigenvalue {lowest:.3g}); repair it"
            )


def definite(information: Float[Array | np.ndarray, "E d d"]) -> bool:
    """Whether all matrices are positive definite."""
    try:
        np.linalg.cholesky(np.asarray(information))
    except np.linalg.LinAlgError:
        return False
    return True


ROUNDING = 1e-5
"""Of the largest eigenvalue: what six digits of a file may make of a zero eigenvalue."""


def negative(information: Float[np.ndarray, "E d d"]) -> Bool[np.ndarray, " E"]:
    """Matrices with an eigenvalue that is negative beyond rounding."""
    values = np.linalg.eigvalsh((information + information.swapaxes(1, 2)) / 2)
    below: np.ndarray = values[:, 0] < -ROUNDING * np.abs(values).max(1)
    return below


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
