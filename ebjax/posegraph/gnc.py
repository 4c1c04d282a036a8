"""Graduated non-convexity (Yang, Antonante, Tzoumas, Carlone 2020): robust estimation without a good start.

The kernel starts so soft that every edge pulls and is sharpened by halves, each time from the poses found so far,
until it is the kernel itself: truncated least squares ("gnc-tls", "consensus"), which counts an edge fully or not at
all, or Geman-McClure ("gnc-gm"). What remains is a local minimum of that kernel, so derivatives hold there as for any
other; with truncation they are those of least squares on the edges that were not cut off.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ebjax.posegraph.assembly import numbers
from ebjax.posegraph.factors import edge_costs, squared_residuals
from ebjax.posegraph.graph import PoseGraph
from ebjax.posegraph.levenberg import Solution, minimise
from ebjax.posegraph.linear import Structure
from ebjax.posegraph.robust import Graduated, chi_square_999

GRADUATED = ("gnc-tls", "gnc-gm", "consensus")
_STEPS = 4  # at one softness
_RTOL = 1e-2
_RECALL = 7.0  # softness at which edges up to eight times beyond the squared width still pull
_SHARP = 1 / 16  # a softness below this is as good as none


class _State(NamedTuple):
    found: Solution
    softness: Float[Array, ""]
    stage: Int[Array, ""]
    short: Bool[Array, ""]


_FIT, _HARDEN, _AGAIN, _SHARPEN, _DONE = range(5)


def graduate(
    graph: PoseGraph,
    structure: Structure,
    kernel: str,
    width: Float[Array, ""] | Float[Array, " E"],
    first: Float[Array, " E"] | None,
    max_steps: int,
    rtol: float,
    report: Any = None,
) -> Solution:
    """As `levenberg.minimise`, for the kernels in `GRADUATED`; an edge of width 0 does not count.

    The kernel hardens twice, the second time from `_RECALL` only, so that edges lost on the way are heard again.

    Where `first` is given least squares on all edges comes first: if they pass the chi-square test together and each
    robust one lies within `width`, nothing is to be doubted. Else the kernel hardens at the width `first`. Either is
    the start for the sharp kernel at `width`. Up to `max_steps` steps are tried while the kernel hardens, as many at
    each other stage; `iterations` counts all. If the first are used up before it is hard, so says `status`.
    """
    start = graph.lie.normalise(jnp.asarray(graph.poses))
    robust, limits = jnp.asarray(graph.robust), jnp.finfo(start.dtype)
    final = jnp.broadcast_to(jnp.asarray(width, start.dtype), robust.shape)
    hard = final if first is None else first
    widths = jnp.stack([jnp.full_like(final, jnp.sqrt(limits.max) / 2), hard, hard, final])
    freedom = _numbers(graph) - jnp.sum(jnp.broadcast_to(numbers(structure.free), (len(start), graph.lie.dim)))

    def worst(poses, width):
        """The largest squared residual of a robust edge that counts, in squared widths."""
        s = squared_residuals(graph, poses)
        return jnp.max(jnp.where(robust & (width > 0), s / jnp.maximum(width**2, limits.tiny), 0), initial=0)

    softest = jnp.maximum(2 * worst(start, hard) - 1, 0)

    def step(state):
        fitting = state.stage == _FIT
        hardening = (state.stage == _HARDEN) | (state.stage == _AGAIN)
        found = minimise(
            replace(graph, poses=state.found.poses),
            structure,
            kernel,
            Graduated(widths[state.stage], state.softness),
            jnp.where(hardening, jnp.minimum(_STEPS, max_steps), max_steps),
            jnp.where(hardening, _RTOL, rtol),
            report,
        )
        tried = state.found.iterations + found.iterations
        short = state.short | (hardening & (tried >= max_steps))
        fits = (found.cost <= chi_square_999(freedom)) & (worst(found.poses, final) <= 1)
        hard_enough = ~hardening | short | (state.softness < 2 * _SHARP)
        stage = jnp.where(fitting & fits, _SHARPEN, state.stage + hard_enough)
        fresh = jnp.stack([0, softest, _RECALL, 0, 0]).astype(start.dtype)[stage]
        softness = jnp.where(hard_enough, fresh, state.softness / 2)
        poses = jnp.where(fitting & ~fits, start, found.poses)
        found = replace(found, poses=poses, initial_cost=state.found.initial_cost, iterations=tried)
        return _State(found, softness, stage.astype(jnp.int32), short)

    none, zero = jnp.zeros((), jnp.int32), jnp.zeros((), start.dtype)
    before = jnp.sum(edge_costs(graph, start, kernel, width))
    begin = Solution(start, zero, before, none, none)
    if first is None:
        state = _State(begin, softest, jnp.where(softest > 0, _HARDEN, _SHARPEN).astype(jnp.int32), jnp.asarray(False))
    else:
        state = _State(begin, zero, none + _FIT, jnp.asarray(False))
    end = jax.lax.while_loop(lambda state: state.stage < _DONE, step, state)
    return replace(end.found, status=jnp.where(end.short & (end.found.status == 0), 1, end.found.status))


def _numbers(graph):
    """Of all residuals together."""
    whole = graph.lie.dim * graph.i.shape[0]
    if graph.position is None:
        return whole
    return whole - (graph.lie.dim - graph.lie.dim // 3 - 1) * jnp.sum(jnp.asarray(graph.position))
