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

from ebjax.posegraph.factors import edge_costs, squared_residuals
from ebjax.posegraph.graph import PoseGraph
from ebjax.posegraph.levenberg import Solution, minimise
from ebjax.posegraph.linear import Structure
from ebjax.posegraph.robust import Graduated

GRADUATED = ("gnc-tls", "gnc-gm", "consensus")
_STEPS = 4  # at one softness
_RTOL = 1e-2
_SHARP = 1 / 16  # a softness below this is as good as none


class _State(NamedTuple):
    found: Solution
    softness: Float[Array, ""]
    stage: Int[Array, ""]  # 0 up to the sharp minimum of the first width, then 1
    short: Bool[Array, ""]


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

    Where `first` is given the kernel hardens at that width, and what it finds is the start for the sharp kernel at
    `width`. Up to `max_steps` steps are tried while the kernel hardens, as many with each sharp one; `iterations`
    counts all. If the first are used up before it is hard, so says `status`.
    """
    start = graph.lie.normalise(jnp.asarray(graph.poses))
    widths = jnp.stack([jnp.broadcast_to(w, (len(graph.i),)) for w in (width if first is None else first, width)])
    last_stage = 0 if first is None else 1
    tiny = jnp.finfo(start.dtype).tiny
    s = squared_residuals(graph, start)
    wide = jnp.asarray(graph.robust) & (widths[0] > 0)
    farthest = jnp.max(jnp.where(wide, s / jnp.maximum(widths[0] ** 2, tiny), 0), initial=0)

    def harden(state):
        soft, so_far = state.softness > 0, state.found.iterations
        found = minimise(
            replace(graph, poses=state.found.poses),
            structure,
            kernel,
            Graduated(widths[state.stage], state.softness),
            jnp.where(soft, jnp.minimum(_STEPS, max_steps), max_steps),
            jnp.where(soft, _RTOL, rtol),
            report,
        )
        found = replace(found, initial_cost=state.found.initial_cost, iterations=so_far + found.iterations)
        short = state.short | (soft & (found.iterations >= max_steps))
        softness = jnp.where(short | (state.softness < 2 * _SHARP), 0, state.softness / 2)
        return _State(found, softness, jnp.where(soft, 0, state.stage + 1), short)

    none, zero = jnp.zeros((), jnp.int32), jnp.zeros((), start.dtype)
    before = jnp.sum(edge_costs(graph, start, kernel, width))
    begin = _State(
        Solution(start, zero, before, none, none), jnp.maximum(2 * farthest - 1, 0), none, jnp.asarray(False)
    )
    end = jax.lax.while_loop(lambda state: state.stage <= last_stage, harden, begin)
    return replace(end.found, status=jnp.where(end.short & (end.found.status == 0), 1, end.found.status))
