"""Marginal covariances of poses and of relative poses: from the inverse of the Gauss-Newton matrix at the solution."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ebjax.posegraph.assembly import assemble
from ebjax.posegraph.capacity import at_capacity, on_host, structure_at_capacity
from ebjax.posegraph.factors import gauss_newton_blocks
from ebjax.posegraph.graph import PoseGraph
from ebjax.posegraph.linear import Structure, analyse, linear_solve
from ebjax.posegraph.matrices import adjoints, to_matrices
from ebjax.posegraph.robust import Kernel, kernel_of
from ebjax.posegraph.sparse import solve_now

_TOGETHER = 32  # poses or pairs that share one factorisation


def marginals(
    graph: PoseGraph,
    rows: Int[Array | np.ndarray, " K"],
    *,
    kernel: Kernel = "cauchy",
    width: float | Float[Array, ""] = 1.0,
    solver: str = "auto",
    structure: Structure | None = None,
) -> Float[Array, "K d d"]:
    """Covariance of delta in pose * exp(delta) for the poses `rows`, tangent order of `ebjax.geometry.lie`.

    With H = sum_k rho'(s_k) J_k^T information_k J_k at `graph.poses`, which should be a solution, the answer is the
    diagonal blocks of H^-1, as gtsam's Marginals gives them. A fixed pose has covariance zero, and so has the rotation
    of a landmark; everything is relative to the fixed poses.

    Raises:
      ValueError: a row outside the graph (where the rows are concrete), unknown kernel or solver.
    """
    _check_rows(graph, rows)
    kernel = kernel_of(kernel)
    structure = analyse(graph, solver, look=True) if structure is None else structure
    if on_host(structure, graph, rows, width):
        rows, none = np.asarray(rows), np.zeros((len(rows), graph.lie.dim, graph.lie.dim))
        return _on_host(graph, rows, rows, none, width, structure, kernel)
    return _marginals(graph, jnp.asarray(rows), jnp.asarray(width, jnp.asarray(graph.poses).dtype), structure, kernel)


def relative_marginals(
    graph: PoseGraph,
    a: Int[Array | np.ndarray, " K"],
    b: Int[Array | np.ndarray, " K"],
    *,
    kernel: Kernel = "cauchy",
    width: float | Float[Array, ""] = 1.0,
    solver: str = "auto",
    structure: Structure | None = None,
) -> Float[Array, "K d d"]:
    """Covariance of delta in a_from_b * exp(delta) for pairs of poses, a_from_b = pose_a^-1 pose_b.

    delta = delta_b - Ad(b_from_a) delta_a = G (delta_a, delta_b), so the answer is G H^-1 G^T, H as in `marginals`,
    from one solve per column of G^T. It does not depend on which pose of a connected graph is fixed, as long as one is;
    poses that no edges connect are each relative to a fixed pose of their own.

    Raises:
      ValueError: as `marginals`, or not as many `a` as `b`.
    """
    if len(a) != len(b):
        raise ValueError(f"{len(a)} poses a but {len(b)} poses b; give one of each per pair")
    for rows in (a, b):
        _check_rows(graph, rows)
    kernel = kernel_of(kernel)
    structure = analyse(graph, solver, look=True) if structure is None else structure
    if on_host(structure, graph, a, b, width):
        a, b, poses = np.asarray(a), np.asarray(b), to_matrices(np.asarray(graph.poses))
        return _on_host(graph, a, b, -adjoints(np.linalg.inv(poses[b]) @ poses[a]), width, structure, kernel)
    width = jnp.asarray(width, jnp.asarray(graph.poses).dtype)
    return _relative_marginals(graph, jnp.asarray(a), jnp.asarray(b), width, structure, kernel)


def _check_rows(graph, rows):
    if not isinstance(rows, jax.core.Tracer) and len(rows) and not 0 <= min(rows) <= max(rows) < len(graph.poses):
        raise ValueError(f"rows go from 0 to {len(graph.poses) - 1}; got {min(rows)} to {max(rows)}")


@partial(jax.jit, static_argnames="kernel")
def _system(graph, structure, width, kernel):
    blocks = gauss_newton_blocks(graph, jnp.asarray(graph.poses), kernel, width)
    return assemble(graph, structure.pattern, blocks, structure.free)[0]


def _on_host(graph, a, b, from_a, width, structure, kernel):
    """G H^-1 G^T of every pair of rows, G = (from_a, I); the program is that of the graph's capacity."""
    dtype, d = jax.dtypes.canonicalize_dtype(graph.poses.dtype), graph.lie.dim
    system = _system(at_capacity(graph), structure_at_capacity(structure), np.asarray(width, dtype), kernel)
    fixed = np.asarray(structure.fixed)[:, None]
    free = np.broadcast_to(~(fixed if structure.held is None else fixed | structure.held), (len(fixed), d))
    out = np.zeros((len(a), d, d), dtype)
    for begin in range(0, len(a), _TOGETHER):
        some = slice(begin, begin + _TOGETHER)
        p, q, by_p = a[some], b[some], from_a[some]
        pair = np.arange(len(p))
        right = np.zeros((len(p), d, len(free), d))
        right[pair, :, p] += by_p * free[p][:, None]
        right[pair, :, q] += np.eye(d) * free[q][:, None]
        columns = solve_now(structure.plan, system, right)
        covariance = columns[pair, :, q] + columns[pair, :, p] @ by_p.swapaxes(1, 2)
        out[some] = (covariance + covariance.swapaxes(1, 2)) / 2
    return jax.device_put(out)


def _inverse(graph, width, structure, kernel):
    """What is free, rows or numbers of tangents, and the function right -> H^-1 right for the columns, (d, N, d)."""
    poses, free = jnp.asarray(graph.poses), structure.free
    system, _ = assemble(graph, structure.pattern, gauss_newton_blocks(graph, poses, kernel, width), free)
    return free, jax.vmap(lambda right: linear_solve(structure, system, right))


def _in_chunks(one, rows):
    """`one` of every row, in whole chunks: XLA may run a last, shorter one beside the others, and CPU threads hang."""
    count = len(jax.tree.leaves(rows)[0])
    if count > _TOGETHER:
        rows = jax.tree.map(lambda x: jnp.pad(x, (0, -count % _TOGETHER)), rows)
    return jax.lax.map(one, rows, batch_size=_TOGETHER)[:count]


@partial(jax.jit, static_argnames="kernel")
def _marginals(graph, rows, width, structure, kernel):
    free, solve = _inverse(graph, width, structure, kernel)
    unit = jnp.eye(graph.lie.dim, dtype=jnp.asarray(graph.poses).dtype)

    def one(row):
        right = jnp.zeros((len(unit), len(free), len(unit)), unit.dtype).at[:, row].set(unit)
        return jnp.where(free[row], solve(right)[:, row], 0)

    return _in_chunks(one, rows)


@partial(jax.jit, static_argnames="kernel")
def _relative_marginals(graph, a, b, width, structure, kernel):
    lie, poses = graph.lie, jnp.asarray(graph.poses)
    free, solve = _inverse(graph, width, structure, kernel)
    unit = jnp.eye(lie.dim, dtype=poses.dtype)

    def one(pair):
        a, b = pair
        from_a = -lie.adjoint(lie.compose(lie.inverse(poses[b]), poses[a]))
        right = jnp.zeros((len(unit), len(free), len(unit)), unit.dtype)
        right = right.at[:, a].add(jnp.where(free[a], from_a, 0)).at[:, b].add(jnp.where(free[b], unit, 0))
        columns = solve(right)
        covariance = columns[:, b] + columns[:, a] @ from_a.T
        return (covariance + covariance.T) / 2

    return _in_chunks(one, (a, b))
