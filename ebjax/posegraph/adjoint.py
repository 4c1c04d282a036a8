"""Derivatives of the optimal poses by the implicit function theorem, in forward and reverse mode.

At the optimum the gradient g(delta, params) of the cost in the tangent space of the free poses is zero, so
d delta / d params = -H^-1 dg / d params with H the true Hessian (kernel and residual curvature included), which has the
pattern of the Gauss-Newton matrix: one sparse factorisation per derivative, whatever the number of steps before.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from ebjax.posegraph.assembly import assemble, matvec
from ebjax.posegraph.factors import edge_costs, edge_gradients, exact_blocks
from ebjax.posegraph.gnc import GRADUATED, graduate
from ebjax.posegraph.graph import PoseGraph
from ebjax.posegraph.levenberg import minimise
from ebjax.posegraph.linear import refined_solve


@partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2, 3, 4))
def optimum(
    group: str, kernel: str, max_steps: int, rtol: float, report: Callable | None, params: tuple, rest: tuple
) -> tuple:
    """The fields of `minimise`'s solution, differentiable in params = (fixed poses, measured, information, width).

    `rest` = (i, j, robust, structure, first width of `graduate`) has no derivative. The starting point has none either,
    and neither have `initial_cost`, `iterations` and `status`. The derivative holds where the cost has a strict local
    minimum and the steps have converged. Plain tuples, because JAX puts other things than arrays into the tangents.
    """
    poses, measured, information, width = params
    i, j, robust, structure, first = rest
    graph = PoseGraph(poses, i, j, measured, information, robust, structure.fixed, group)
    if kernel in GRADUATED:
        solution = graduate(graph, structure, kernel, width, first, max_steps, rtol, report)
    else:
        solution = minimise(graph, structure, kernel, width, max_steps, rtol, report)
    return solution.poses, solution.cost, solution.initial_cost, solution.iterations, solution.status


@optimum.defjvp
def _optimum_jvp(group, kernel, max_steps, rtol, report, primals, tangents):
    params, rest = primals
    solution = optimum(group, kernel, max_steps, rtol, report, params, rest)
    i, j, robust, structure, _ = rest
    graph = PoseGraph(params[0], i, j, params[1], params[2], robust, structure.fixed, group)
    lie = graph.lie
    fixed = jnp.asarray(graph.fixed)

    def with_params(params):
        poses, measured, information, _ = params
        poses = jnp.where(fixed[:, None], poses, solution[0])
        return replace(graph, poses=poses, measured=measured, information=information)

    def gradient(params):
        at = with_params(params)
        gi, gj = edge_gradients(at, at.poses, kernel, params[3])
        total = jnp.zeros((len(fixed), lie.dim), gi.dtype).at[graph.i].add(gi).at[graph.j].add(gj)
        return jnp.where(fixed[:, None], 0, total)

    def moved(params, delta):
        at = with_params(params)
        poses = lie.compose(at.poses, lie.exp(delta))
        return poses, jnp.sum(edge_costs(at, poses, kernel, params[3]))

    _, right = jax.jvp(gradient, (params,), (tangents[0],))
    blocks = exact_blocks(with_params(params), solution[0], kernel, params[3])
    system, _ = assemble(graph, structure.pattern, blocks, ~fixed)
    delta = jax.lax.custom_linear_solve(
        lambda x: matvec(system, structure.pattern, x),
        -right,
        lambda _, b: refined_solve(structure, system, b),
        symmetric=True,
    )
    _, (poses_dot, cost_dot) = jax.jvp(moved, (params, jnp.zeros_like(delta)), (tangents[0], delta))
    none = np.zeros((), jax.dtypes.float0)
    return solution, (poses_dot, cost_dot, jnp.zeros_like(solution[2]), none, none)
