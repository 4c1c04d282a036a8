"""Graduated non-convexity (Yang, Antonante, Tzoumas, Carlone 2020): robust estimation without a good start.

The kernel starts so soft that every edge pulls and is sharpened by halves, each time from the poses found so far,
until it is the kernel itself: truncated least squares ("gnc-tls"), which counts an edge fully or not at all, or
Geman-McClure ("gnc-gm"). What remains is a local minimum of that kernel, so derivatives hold there as for any other;
with "gnc-tls" they are those of least squares on the edges that were not cut off.
"""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ebjax.posegraph.factors import edge_costs, squared_residuals
from ebjax.posegraph.graph import PoseGraph
from ebjax.posegraph.levenberg import Solution, minimise
from ebjax.posegraph.linear import Structure
from ebjax.posegraph.robust import Graduated

GRADUATED = ("gnc-tls", "gnc-gm")
_STEPS = 4  # at one softness
_RTOL = 1e-2
_SHARP = 1 / 16  # a softness below this is as good as none


def graduate(
    graph: PoseGraph,
    structure: Structure,
    kernel: str,
    width: Float[Array, ""] | Float[Array, " E"],
    max_steps: int,
    rtol: float,
    report: Any = None,
) -> Solution:
    """As `levenberg.minimise`, for the kernels in `GRADUATED`; an edge of width 0 does not count.

    Up to `max_steps` steps while the kernel hardens and as many afterwards; `iterations` counts both. If the first
    are used up before it is hard, so says `status`.
    """
    start = jnp.asarray(graph.poses)
    tiny = jnp.finfo(start.dtype).tiny
    s = squared_residuals(graph, start)
    wide = jnp.asarray(graph.robust) & (width > 0)
    farthest = jnp.max(jnp.where(wide, s / jnp.maximum(width * width, tiny), 0), initial=0)

    def soft(state):
        _, softness, steps = state
        return (softness > 0) & (steps < max_steps)

    def sharpen(state):
        poses, softness, steps = state
        at = replace(graph, poses=poses)
        found = minimise(at, structure, kernel, Graduated(width, softness), min(_STEPS, max_steps), _RTOL, report)
        softness = jnp.where(softness < 2 * _SHARP, 0, softness / 2)
        return found.poses, softness, steps + found.iterations

    first = (graph.lie.normalise(start), jnp.maximum(2 * farthest - 1, 0), jnp.zeros((), jnp.int32))
    poses, softness, steps = jax.lax.while_loop(soft, sharpen, first)
    last = minimise(replace(graph, poses=poses), structure, kernel, width, max_steps, rtol, report)
    before = jnp.sum(edge_costs(graph, first[0], kernel, width))
    status = jnp.where((softness > 0) & (last.status == 0), 1, last.status)
    return Solution(last.poses, last.cost, before, steps + last.iterations, status)
