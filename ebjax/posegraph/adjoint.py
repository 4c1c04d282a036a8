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
from jax.custom_derivatives import SymbolicZero

from ebjax.posegraph.assembly import assemble, matvec, numbers
from ebjax.posegraph.factors import edge_costs, exact_blocks, gradient_change
from ebjax.posegraph.gnc import GRADUATED, graduate
from ebjax.posegraph.graph import PoseGraph
from ebjax.posegraph.levenberg import minimise
from ebjax.posegraph.linear import linear_solve
from ebjax.posegraph.robust import Kernel


@partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2, 3, 4))
def optimum(
    group: str, kernel: Kernel, max_steps: int, rtol: float, report: Callable | None, params: tuple, rest: tuple
) -> tuple:
    """The fields of `minimise`'s solution, differentiable in params = (fixed poses, measured, information, width).

    `rest` = (i, j, robust, position, structure, first width of `graduate`) has no derivative. The starting point has
    none either, and neither have `initial_cost`, `iterations` and `status`. The derivative holds where the cost has a
    strict local minimum and the steps have converged. Plain tuples, because JAX puts other things than arrays into the
    tangents.
    """
    poses, measured, information, width = params
    i, j, robust, position, structure, first = rest
    graph = PoseGraph(poses, i, j, measured, information, robust, structure.fixed, group, position)
    if kernel in GRADUATED:
        solution = graduate(graph, structure, kernel, width, first, max_steps, rtol, report)
    else:
        solution = minimise(graph, structure, kernel, width, max_steps, rtol, report)
    return solution.poses, solution.cost, solution.initial_cost, solution.iterations, solution.status


def _optimum_jvp(group, kernel, max_steps, rtol, report, primals, tangents):
    params, rest = primals
    solution = optimum(group, kernel, max_steps, rtol, report, params, rest)
    i, j, robust, position, structure, _ = rest
    graph = PoseGraph(params[0], i, j, params[1], params[2], robust, structure.fixed, group, position)
    lie, free = graph.lie, structure.free
    fixed = jnp.asarray(graph.fixed)
    change = [None if isinstance(t, SymbolicZero) else t for t in tangents[0]]
    if change[0] is not None:
        change[0] = jnp.where(fixed[:, None], change[0], 0)

    blocks, sensitivity = exact_blocks(graph, solution[0], kernel, params[3])
    gi, gj = gradient_change(graph, solution[0], kernel, params[3], sensitivity, change)
    right = jnp.zeros((len(fixed), lie.dim), gi.dtype).at[graph.i].add(gi).at[graph.j].add(gj)
    system, _ = assemble(graph, structure.pattern, blocks, free)
    delta = jax.lax.custom_linear_solve(
        lambda x: matvec(system, structure.pattern, x),
        jnp.where(numbers(free), -right, 0),
        lambda _, b: linear_solve(structure, system, b),
        symmetric=True,
    )

    def moved(delta, poses, measured, information, width):
        poses = lie.compose(poses, lie.exp(delta))
        costs = edge_costs(replace(graph, measured=measured, information=information), poses, kernel, width)
        return poses, jnp.sum(costs)

    at = (jnp.zeros_like(delta), solution[0], *params[1:])
    change = [jnp.zeros_like(p) if t is None else t for p, t in zip(at[1:], change, strict=True)]
    _, (poses_dot, cost_dot) = jax.jvp(moved, at, (delta, *change))
    none = np.zeros((), jax.dtypes.float0)
    return solution, (poses_dot, cost_dot, jnp.zeros_like(solution[2]), none, none)


optimum.defjvp(_optimum_jvp, symbolic_zeros=True)
