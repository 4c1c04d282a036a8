"""The front door: `solve(graph)` optimises a pose graph; jit, vmap and differentiate it as you like."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ebjax.posegraph import stepped
from ebjax.posegraph.adjoint import optimum
from ebjax.posegraph.capacity import at_capacity, concrete, filled, on_host
from ebjax.posegraph.consensus import RULES, believed
from ebjax.posegraph.graph import PoseGraph, check
from ebjax.posegraph.levenberg import Report, Solution
from ebjax.posegraph.linear import Structure, analyse
from ebjax.posegraph.robust import Kernel, default_width, kernel_of, weight

Prepared = tuple[tuple[Any, ...], tuple[Any, ...]]
"""`params` and `rest` of `optimum`."""


def solve(
    graph: PoseGraph,
    *,
    kernel: Kernel = "cauchy",
    width: float | Float[Array, ""] | Float[Array, " E"] | Float[np.ndarray, " E"] | None = None,
    max_steps: int = 200,
    rtol: float = 1e-9,
    solver: str = "auto",
    structure: Structure | None = None,
    report: Report | None = None,
) -> Solution:
    """Minimises sum_k rho(r_k^T information_k r_k), r = log(measured^-1 * i_from_j), from `graph.poses`.

    The kernel applies to the edges marked `robust`. Where nothing says where a connected piece of the graph lies in the
    world, its first pose stays where it is. Everything has the dtype of `graph.poses`; float64 needs JAX's
    x64 mode (`ebjax.setup_jax`). Gradients of `poses` and `cost` with respect to measured, information, width and the
    fixed poses are exact at convergence (`ebjax.posegraph.adjoint`): give them a small `rtol`, 1e-20 say.

    Args:
      graph: without edges, or with fewer than two poses, it is returned as it is, cost 0, converged.
      kernel: "none", "cauchy", "huber", "geman-mcclure", "dcs", "tls"; graduated (`ebjax.posegraph.gnc`): "gnc-tls",
        "gnc-gm"; or a choice of loops first (`ebjax.posegraph.consensus`, not under jit), the edges between successive
        rows being believed: "pcm" is Cauchy on the largest consistent set, "consensus" is least squares where that fits
        all loops, else gnc-tls on the loops that others confirm, then tls on all from there. One of your own is a
        function rho(s, width^2) of JAX arrays, or `my_package.mine:NAME` (`ebjax.posegraph.robust`).
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
        eigenvalue, or rows that nothing determines (the last three only where the arrays are concrete); a float64 graph
        where JAX's x64 mode is off.
    """
    kernel = kernel_of(kernel)
    prepared = _prepared(graph, kernel, width, solver, structure)
    return prepared if isinstance(prepared, Solution) else _run(prepared, graph.group, kernel, max_steps, rtol, report)


def cut_off(
    graph: PoseGraph, poses: Float[Array | np.ndarray, "N P"], *, kernel: Kernel = "cauchy", width: float | None = None
) -> Bool[np.ndarray, " E"]:
    """Robust edges that count for nothing at `poses`, which kernels that truncate have; the options as in `solve`."""
    kernel, full = kernel_of(kernel), at_capacity(replace(graph, poses=poses))
    squared = np.asarray(stepped.squared_residuals(full, full.poses))
    at = np.asarray(_default_width(graph, kernel) if width is None else width, squared.dtype)
    weights = _weights(squared, filled(at, len(squared), 1) if at.ndim else at, kernel)
    return np.asarray(np.asarray(graph.robust) & (np.asarray(weights)[: len(graph.i)] == 0))


@partial(jax.jit, static_argnames="kernel")
def _weights(squared: Array, width: Array, kernel: Kernel) -> Array:
    return weight(kernel, squared, width)


def _default_width(graph: PoseGraph, kernel: Kernel) -> float | np.ndarray:
    width = default_width(kernel, graph.lie.dim)
    if graph.position is None:
        return width
    return np.where(np.asarray(graph.position), default_width(kernel, graph.lie.dim // 3 + 1), width)


def compile_solve(graph: PoseGraph, **options: Any) -> Callable[[], Solution]:
    """Makes the programs of `solve(graph, **options)`, so that the two can be timed apart."""
    given: dict[str, Any] = {
        "kernel": "cauchy",
        "width": None,
        "max_steps": 200,
        "rtol": 1e-9,
        "solver": "auto",
        "structure": None,
        "report": None,
    }
    given |= options
    given["kernel"] = kernel = kernel_of(given["kernel"])
    prepared = _prepared(graph, *(given.pop(name) for name in ("kernel", "width", "solver", "structure")))
    if isinstance(prepared, Solution):
        return lambda: prepared
    static = {"group": graph.group, "kernel": kernel} | given
    if on_host(prepared[1][4], prepared):
        _run(prepared, **(static | {"max_steps": 1, "report": None}))
        return lambda: _run(prepared, **static)
    program = _solve.lower(*prepared, **static).compile()
    return lambda: program(*prepared)


def _prepared(
    graph: PoseGraph, kernel: Kernel, width: Any, solver: str, structure: Structure | None
) -> Solution | Prepared:
    """`params` and `rest` of `optimum`; the solution where there is nothing to solve."""
    check(graph)
    dtype = jax.dtypes.canonicalize_dtype(graph.poses.dtype)
    if dtype != graph.poses.dtype:
        raise ValueError(f"the graph is in {graph.poses.dtype} and JAX in {dtype}: call ebjax.setup_jax() first")
    width = _default_width(graph, kernel) if width is None else width
    if len(graph.poses) < 2 or len(graph.i) == 0:
        zero, none = np.zeros((), dtype), np.zeros((), np.int32)
        return Solution(*jax.device_put((graph.poses, zero, zero, none, none)))
    information, first = graph.information, None
    if kernel in RULES:
        chosen = believed(graph, kernel)
        graph = replace(graph, robust=chosen.loop)
        if kernel == "pcm":
            information = np.asarray(information) * (chosen.kept | ~chosen.loop)[:, None, None]
        else:
            first = np.asarray(width * (chosen.kept if chosen.kept.any() else chosen.loop), dtype)
    if structure is None:
        structure = analyse(graph, solver, look=True)
    numbers = (graph.poses, graph.measured, information, width)
    cast = np.asarray if concrete(numbers) else jnp.asarray
    params = tuple(cast(x, dtype) for x in numbers)
    return params, (graph.i, graph.j, graph.robust, graph.position, structure, first)


def _run(
    prepared: Prepared, group: str, kernel: Kernel, max_steps: int, rtol: float, report: Report | None
) -> Solution:
    (poses, measured, information, width), (i, j, robust, position, structure, first) = prepared
    if not on_host(structure, prepared):
        found: Solution = _solve(*prepared, group=group, kernel=kernel, max_steps=max_steps, rtol=rtol, report=report)
        return found
    graph = PoseGraph(poses, i, j, measured, information, robust, structure.fixed, group, position)
    return stepped.optimum(graph, structure, kernel, width, first, max_steps, rtol, report)


@partial(jax.jit, static_argnames=("group", "kernel", "max_steps", "rtol", "report"))
def _solve(
    params: tuple[Any, ...],
    rest: tuple[Any, ...],
    *,
    group: str,
    kernel: Kernel,
    max_steps: int,
    rtol: float,
    report: Report | None,
) -> Solution:
    return Solution(*optimum(group, kernel, max_steps, rtol, report, params, rest))
