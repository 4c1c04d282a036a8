"""Marginal covariances of poses: blocks of the inverse of the Gauss-Newton matrix at the solution."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ebjax.posegraph.assembly import assemble
from ebjax.posegraph.factors import gauss_newton_blocks
from ebjax.posegraph.graph import PoseGraph
from ebjax.posegraph.linear import Structure, analyse, linear_solve
from ebjax.posegraph.robust import check_kernel

_TOGETHER = 32  # poses that share one factorisation


def marginals(
    graph: PoseGraph,
    rows: Int[Array | np.ndarray, " K"],
    *,
    kernel: str = "cauchy",
    width: float | Float[Array, ""] = 1.0,
    solver: str = "auto",
    structure: Structure | None = None,
) -> Float[Array, "K d d"]:
    """Covariance of delta in pose * exp(delta) for the poses `rows`, tangent order of `ebjax.geometry.lie`.

    With H = sum_k rho'(s_k) J_k^T information_k J_k at `graph.poses`, which should be a solution, the answer is the
    diagonal blocks of H^-1, as gtsam's Marginals gives them. A fixed pose has covariance zero; everything is relative
    to the fixed poses.

    Raises:
      ValueError: a row outside the graph (where the rows are concrete), unknown kernel or solver.
    """
    if not isinstance(rows, jax.core.Tracer) and len(rows) and not 0 <= min(rows) <= max(rows) < len(graph.poses):
        raise ValueError(f"rows go from 0 to {len(graph.poses) - 1}; got {min(rows)} to {max(rows)}")
    check_kernel(kernel)
    structure = analyse(graph, solver) if structure is None else structure
    return _marginals(graph, jnp.asarray(rows), jnp.asarray(width, jnp.asarray(graph.poses).dtype), structure, kernel)


@partial(jax.jit, static_argnames="kernel")
def _marginals(graph, rows, width, structure, kernel):
    poses, free = jnp.asarray(graph.poses), ~jnp.asarray(structure.fixed)
    system, gradient = assemble(graph, structure.pattern, gauss_newton_blocks(graph, poses, kernel, width), free)
    unit = jnp.eye(gradient.shape[1], dtype=poses.dtype)

    def one(row):
        columns = jax.vmap(lambda e: linear_solve(structure, system, jnp.zeros_like(gradient).at[row].set(e)))(unit)
        return jnp.where(free[row], columns[:, row], 0)

    return jax.lax.map(one, rows, batch_size=_TOGETHER)
