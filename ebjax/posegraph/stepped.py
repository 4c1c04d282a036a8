"""The same Levenberg-Marquardt stepped from the host: what `solve` does where no array is traced.

A program that calls back to the host is compiled anew in every process, and a program whose shapes are a graph's anew
for every graph. Here the factorisation stands between programs that call nothing, at the graph's capacity
(`ebjax.posegraph.capacity`): they are compiled once, and read from JAX's cache ever after.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

from ebjax.posegraph import gnc
from ebjax.posegraph.capacity import at_capacity, filled, structure_at_capacity
from ebjax.posegraph.graph import PoseGraph
from ebjax.posegraph.levenberg import Levenberg, Solution, levenberg, moved, solution
from ebjax.posegraph.linear import Structure
from ebjax.posegraph.robust import Kernel
from ebjax.posegraph.sparse import SparsePlan, solve_now


@jax.jit
def _normalised(graph):
    return graph.lie.normalise(graph.poses)


@jax.jit
def _begin(solver, y, squared):
    state = solver.begin(y, squared)
    return state, _over(solver, y, state)


@jax.jit
def _accept(solver, y, state, *step):
    y, state, tried = solver.accept(y, state, *step)
    return y, state, tried, _over(solver, y, state)


def _over(solver, y, state):
    return solver.terminate(None, y, None, None, state, None)[0]


_linearise = jax.jit(Levenberg.linearise)
_moved = jax.jit(moved)
_solution = jax.jit(solution)
_begin_stages = jax.jit(gnc.begin, static_argnames="kernel")
_advance = jax.jit(gnc.advance)


def squared_residuals(graph: PoseGraph, poses: Any) -> Array:
    """As `factors.squared_residuals`, of a graph at capacity."""
    return _moved(graph, poses, np.zeros((len(poses), graph.lie.dim), poses.dtype))[1]


def minimise(
    graph: PoseGraph,
    structure: Structure,
    kernel: Kernel,
    width: Any,
    max_steps: Any,
    rtol: Any,
    plan: SparsePlan,
    report: Callable | None = None,
) -> Solution:
    """As `levenberg.minimise`; the graph and its structure are at capacity, the plan is not."""
    solver = levenberg(graph, structure, kernel, width, max_steps, rtol)
    y = _normalised(graph)
    state, over = _begin(solver, y, squared_residuals(graph, y))
    while not over:
        system, gradient = _linearise(solver, y, state)
        delta = -solve_now(plan, system, gradient)
        y, state, tried, over = _accept(solver, y, state, gradient, delta, *_moved(graph, y, delta))
        if report is not None:
            report(*tried)
    return _solution(graph, y, state)


def optimum(
    graph: PoseGraph,
    structure: Structure,
    kernel: Kernel,
    width: Float[np.ndarray, ""] | Float[np.ndarray, " E"],
    first: Float[np.ndarray, " E"] | None,
    max_steps: int,
    rtol: float,
    report: Callable | None,
) -> Solution:
    """As `adjoint.optimum`, without derivatives, of concrete arrays and a structure with a sparse plan."""
    rows, plan = len(graph.poses), structure.plan
    assert isinstance(plan, SparsePlan)
    graph, structure = at_capacity(replace(graph, fixed=structure.fixed)), structure_at_capacity(structure)
    edges, dtype = len(graph.i), graph.poses.dtype
    if width.ndim:
        width = filled(width, edges, 1)
    first = None if first is None else filled(first, edges, 1)
    given = (graph, structure, width, first, np.asarray(max_steps, np.int32), np.asarray(rtol, dtype))
    graph, structure, width, first, steps, least = jax.device_put(given)
    if kernel not in gnc.GRADUATED:
        return _shortened(minimise(graph, structure, kernel, width, steps, least, plan, report), rows)
    start = _normalised(graph)
    squared = squared_residuals(graph, start)
    course, stage = _begin_stages(graph, structure, start, squared, width, first, steps, least, kernel=kernel)
    while int(stage.stage) < gnc.DONE:
        here, ask = replace(graph, poses=stage.found.poses), stage.asked
        found = minimise(here, structure, kernel, ask.width, ask.max_steps, ask.rtol, plan, report)
        stage = _advance(course, stage, found, squared_residuals(graph, found.poses))
    return _shortened(stage.found, rows)


def _shortened(found: Solution, rows: int) -> Solution:
    return replace(found, poses=jax.device_put(np.asarray(found.poses)[:rows]))
