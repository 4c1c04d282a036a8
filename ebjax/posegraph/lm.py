"""The front door: `solve(graph)` optimises a pose graph; jit, vmap and differentiate it as you like."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ebjax.posegraph.adjoint import optimum
from ebjax.posegraph.consensus import RULES, believed
from ebjax.posegraph.factors import squared_residuals
from ebjax.posegraph.graph import PoseGraph, check
from ebjax.posegraph.levenberg import Solution
from ebjax.posegraph.linear import Structure, analyse
from ebjax.posegraph.robust import check_kernel, default_width, weight


def solve(
    graph: PoseGraph,
    *,
    kernel: str = "cauchy",
    width: float | Float[Array, ""] | Float[Array, " E"] | Float[np.ndarray, " E"] | None = None,
    max_steps: int = 200,
    rtol: float = 1e-9,
    solver: str = "auto",
    structure: Structure | None = None,
    report: Callable | None = None,
) -> Solution:
    """Minimises sum_k rho(r_k^T information_k r_k), r = log(measured^-1 * i_from_j), from `graph.poses`.

    The kernel applies to the edges marked `robust`. Where nothing says where a connected piece of the graph lies in the
    world, its first pose stays where it is. Everything has the dtype of `graph.poses`; float64 needs JAX's x64 mode.
    Gradients of `poses` and `cost` with respect to measured, information, width and the fixed poses are exact at
    convergence (`ebjax.posegraph.adjoint`): give them a small `rtol`, 1e-20 say.

    Args:
      graph: without edges, or with fewer than two poses, it is returned as it is, cost 0, converged.
      kernel: "none", "cauchy", "huber", "geman-mcclure", "dcs", "tls"; graduated (`ebjax.posegraph.gnc`): "gnc-tls",
        "gnc-gm"; or a choice of loops first (`ebjax.posegraph.consensus`, not under jit), the edges between successive
        rows being believed: "pcm" is Cauchy on the largest consistent set, "consensus" is least squares where that fits
        all loops, else gnc-tls on the loops that others confirm, then tls on all from there.
      width: of the kernel, in standard deviations, one for all edges or one per edge; None is 1, and for the kernels
        that cut off the root of the 99.9 % point of chi-square with as many degrees of freedom as the edge has numbers.
      max_steps: steps tried at most, accepted or not.
      rtol: the loop ends when a step lowers the cost, and promised to lower it, by less than this share.
      solver: "auto", "elimination", "qdldl", "supernodal" or "cholmod"; see `ebjax.posegraph.linear.analyse`.
      structure: the result of `analyse(graph)`, needed where `i`, `j` or `fixed` are traced.
      report: called on the host after every step with (step, cost tried, whether accepted, damping).

    Returns:
      A `Solution`; non-convergence is its `status`, not an error.

    Raises:
      ValueError: unknown kernel or solver, wrong shapes, non-finite numbers, an information matrix with a negative
        eigenvalue, or rows that nothing determines (the last three only where the arrays are concrete).
    """
    return _call(graph, kernel, width, max_steps, rtol, solver, structure, report, _solve)


def cut_off(
    graph: PoseGraph, poses: Float[Array, "N P"], *, kernel: str = "cauchy", width: float | None = None
) -> Bool[np.ndarray, " E"]:
    """Robust edges that count for nothing at `poses`, which kernels that truncate have; the options as in `solve`."""
    at = jnp.asarray(_default_width(graph, kernel) if width is None else width, jnp.asarray(poses).dtype)
    return np.asarray(graph.robust) & (np.asarray(_weights(graph, poses, at, kernel)) == 0)


def _default_width(graph, kernel):
    width = default_width(kernel, graph.lie.dim)
    if graph.position is None:
        return width
    return np.where(np.asarray(graph.position), default_width(kernel, graph.lie.dim // 3 + 1), width)


@partial(jax.jit, static_argnames="kernel")
def _weights(graph, poses, width, kernel):
    return weight(kernel, squared_residuals(graph, poses), width)


def compile_solve(graph: PoseGraph, **options: Any) -> Callable[[], Solution]:
    """Compiles `solve(graph, **options)` without running it, so that the two can be timed apart."""
    prepared: dict[str, Any] = {
        "kernel": "cauchy",
        "width": None,
        "max_steps": 200,
        "rtol": 1e-9,
        "solver": "auto",
        "structure": None,
        "report": None,
    }

    def compiled(*args, **static):
        program = _solve.lower(*args, **static).compile()
        return lambda: program(*args)

    answer = _call(graph, function=compiled, **(prepared | options))
    return (lambda: answer) if isinstance(answer, Solution) else answer


def _call(graph, kernel, width, max_steps, rtol, solver, structure, report, function):
    check_kernel(kernel)
    check(graph)
    dtype = jnp.asarray(graph.poses).dtype
    width = _default_width(graph, kernel) if width is None else width
    if len(graph.poses) < 2 or len(graph.i) == 0:
        zero, none = jnp.zeros((), dtype), jnp.zeros((), jnp.int32)
        return Solution(jnp.asarray(graph.poses), zero, zero, none, none)
    information, first = graph.information, None
    if kernel in RULES:
        chosen = believed(graph, kernel)
        graph = replace(graph, robust=chosen.loop)
        if kernel == "pcm":
            information = np.asarray(information) * (chosen.kept | ~chosen.loop)[:, None, None]
        else:
            first = jnp.asarray(width * (chosen.kept if chosen.kept.any() else chosen.loop), dtype)
    if structure is None:
        structure = analyse(graph, solver, look=True)
    params = tuple(jnp.asarray(x, dtype) for x in (graph.poses, graph.measured, information, width))
    rest = (graph.i, graph.j, graph.robust, graph.position, structure, first)
    return function(params, rest, group=graph.group, kernel=kernel, max_steps=max_steps, rtol=rtol, report=report)


@partial(jax.jit, static_argnames=("group", "kernel", "max_steps", "rtol", "report"))
def _solve(params, rest, *, group, kernel, max_steps, rtol, report):
    return Solution(*optimum(group, kernel, max_steps, rtol, report, params, rest))
