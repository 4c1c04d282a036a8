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
from ebjax.posegraph.factors import squared_residuals
from ebjax.posegraph.graph import PoseGraph
from ebjax.posegraph.levenberg import Solution, minimise
from ebjax.posegraph.linear import Structure
from ebjax.posegraph.robust import Graduated, Kernel, chi_square_999, rho

GRADUATED = ("gnc-tls", "gnc-gm", "consensus")
_STEPS = 4  # at one softness
_RTOL = 1e-2
_RECALL = 7.0  # softness at which edges up to eight times beyond the squared width still pull
_SHARP = 1 / 16  # a softness below this is as good as none


_FIT, _HARDEN, _AGAIN, _SHARPEN, DONE = range(5)


class Asked(NamedTuple):
    """What the next stretch of steps shall minimise, from the poses found, and how far."""

    width: Graduated
    max_steps: Int[Array, ""]
    rtol: Float[Array, ""]


class Stage(NamedTuple):
    """Between two stretches of steps; `short`: the kernel did not become hard in the steps allowed."""

    found: Solution
    stage: Int[Array, ""]
    short: Bool[Array, ""]
    asked: Asked


class Course(NamedTuple):
    """What all stages share: `start`, widths while it hardens and in the end, degrees of freedom, limits."""

    graph: PoseGraph
    start: Float[Array, "N P"]
    hard: Float[Array, " E"]
    final: Float[Array, " E"]
    softest: Float[Array, ""]
    freedom: Int[Array, ""]
    max_steps: Int[Array, ""]
    rtol: Float[Array, ""]


def graduate(
    graph: PoseGraph,
    structure: Structure,
    kernel: Kernel,
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
    squared = squared_residuals(graph, start)
    course, state = begin(graph, structure, start, squared, width, first, max_steps, rtol, kernel=kernel)

    def step(state):
        here, ask = replace(graph, poses=state.found.poses), state.asked
        found = minimise(here, structure, kernel, ask.width, ask.max_steps, ask.rtol, report)
        return advance(course, state, found, squared_residuals(graph, found.poses))

    return jax.lax.while_loop(lambda state: state.stage < DONE, step, state).found


def begin(
    graph: PoseGraph,
    structure: Structure,
    start: Float[Array, "N P"],
    squared: Float[Array, " E"],
    width: Float[Array, ""] | Float[Array, " E"],
    first: Float[Array, " E"] | None,
    max_steps: int | Int[Array, ""],
    rtol: float | Float[Array, ""],
    *,
    kernel: Kernel,
) -> tuple[Course, Stage]:
    """The course, and the first stage of it; the squared residuals are those at `start`."""
    final = jnp.broadcast_to(jnp.asarray(width, start.dtype), jnp.shape(graph.robust))
    hard = final if first is None else first
    freedom = _numbers(graph) - jnp.sum(jnp.broadcast_to(numbers(structure.free), (len(start), graph.lie.dim)))
    softest = jnp.maximum(2 * _worst(graph, squared, hard) - 1, 0)
    limits = jnp.asarray(max_steps, jnp.int32), jnp.asarray(rtol, start.dtype)
    course = Course(graph, start, hard, final, softest, freedom, *limits)
    none, zero = jnp.zeros((), jnp.int32), jnp.zeros((), start.dtype)
    cost = jnp.sum(jnp.where(jnp.asarray(graph.robust), rho(kernel, squared, jnp.asarray(width)), squared))
    found = Solution(start, zero, cost, none, none)
    if first is None:
        stage, softness = jnp.where(softest > 0, _HARDEN, _SHARPEN).astype(jnp.int32), softest
    else:
        stage, softness = none + _FIT, zero
    return course, Stage(found, stage, jnp.asarray(False), _asked(course, stage, softness))


def _asked(course, stage, softness):
    everything = jnp.full_like(course.final, jnp.sqrt(jnp.finfo(course.final.dtype).max) / 2)
    widths = jnp.stack([everything, course.hard, course.hard, course.final, course.final])
    hardening = _hardening(stage)
    steps = jnp.where(hardening, jnp.minimum(_STEPS, course.max_steps), course.max_steps)
    return Asked(Graduated(widths[stage], softness), steps, jnp.where(hardening, _RTOL, course.rtol))


def _hardening(stage):
    return (stage == _HARDEN) | (stage == _AGAIN)


def _worst(graph, squared, width):
    """The largest squared residual of a robust edge that counts, in squared widths."""
    counts = jnp.asarray(graph.robust) & (width > 0)
    return jnp.max(jnp.where(counts, squared / jnp.maximum(width**2, jnp.finfo(squared.dtype).tiny), 0), initial=0)


def advance(course: Course, state: Stage, found: Solution, squared: Float[Array, " E"]) -> Stage:
    """The stage after the one whose steps found `found`, and the squared residuals there."""
    softness = state.asked.width.softness
    fitting, hardening = state.stage == _FIT, _hardening(state.stage)
    tried = state.found.iterations + found.iterations
    short = state.short | (hardening & (tried >= course.max_steps))
    fits = (found.cost <= chi_square_999(course.freedom)) & (_worst(course.graph, squared, course.final) <= 1)
    hard_enough = ~hardening | short | (softness < 2 * _SHARP)
    stage = jnp.where(fitting & fits, _SHARPEN, state.stage + hard_enough).astype(jnp.int32)
    fresh = jnp.stack([0, course.softest, _RECALL, 0, 0]).astype(softness.dtype)[stage]
    softness = jnp.where(hard_enough, fresh, softness / 2)
    poses = jnp.where(fitting & ~fits, course.start, found.poses)
    status = jnp.where(short & (found.status == 0), 1, found.status)
    found = Solution(poses, found.cost, state.found.initial_cost, tried, status)
    return Stage(found, stage, short, _asked(course, stage, softness))


def _numbers(graph):
    """Of all residuals together; an edge without information has none."""
    counts = jnp.any(jnp.asarray(graph.information) != 0, (1, 2))
    whole = graph.lie.dim * jnp.sum(counts)
    if graph.position is None:
        return whole
    return whole - (graph.lie.dim - graph.lie.dim // 3 - 1) * jnp.sum(counts & jnp.asarray(graph.position))
