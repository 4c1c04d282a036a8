"""Pose-graph optimisation: Levenberg-Marquardt on the manifold with a sparse step, run by optimistix.

Minimises sum_k rho(r_k^T information_k r_k) (Early Bird, section III-D, with Cauchy's rho). A step solves
(H + damping I) delta = -gradient with the graph's own blocks, where optimistix's LevenbergMarquardt would build a
dense or matrix-free Jacobian. Damping starts at 1e-5; it falls tenfold after a step that gains at least three
quarters of what was predicted and grows fourfold after one that gains less than a quarter, tenfold after one that is
refused, and faster when several are.

A step is in three parts, `linearise`, then the linear solve, `moved` and `accept`, so that it can be one program, as
in `minimise`, or be made from the host (`ebjax.posegraph.stepped`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from ebjax.posegraph.assembly import System, assemble, damped
from ebjax.posegraph.factors import edge_costs, gauss_newton_blocks, squared_residuals
from ebjax.posegraph.graph import PoseGraph
from ebjax.posegraph.linear import Structure, linear_solve
from ebjax.posegraph.robust import Kernel, Width, rho

STATUS = ("converged", "steps used up", "stalled at the largest damping", "not finite")
_RUNNING = 1
_FIRST_DAMPING = 1e-5
_SMALLEST_DAMPING, _LARGEST_DAMPING = 1e-12, 1e12
_FASTEST_RATE = 0.01
_LATE = 1e-4  # predicted relative decrease below which the kernel's curvature enters: earlier it costs rejected steps


class _Edges(NamedTuple):
    """A graph without its poses: what travels through optimistix, which may put other things in place of arrays."""

    i: Any
    j: Any
    measured: Any
    information: Any
    robust: Any
    fixed: Any
    position: Any

    def graph(self, poses, group):
        return PoseGraph(poses, *self[:-1], group, self.position)


class _State(NamedTuple):
    """`half` is half the cost of the iterate, `initial` of the start, `decrease` what the last accepted step gained.

    `refused` counts the steps refused since; `floor` is what rounding of the poses alone makes of half the cost.
    """

    floor: Float[Array, ""]
    late: Bool[Array, ""]
    half: Float[Array, ""]
    initial: Float[Array, ""]
    decrease: Float[Array, ""]
    damping: Float[Array, ""]
    refused: Int[Array, ""]
    status: Int[Array, ""]
    steps: Int[Array, ""]


class Tried(NamedTuple):
    """What a report says of a step: its number, the cost tried, whether it was accepted, and the damping."""

    step: Int[Array, ""]
    cost: Float[Array, ""]
    accepted: Bool[Array, ""]
    damping: Float[Array, ""]


class Levenberg(optx.AbstractLeastSquaresSolver):
    """One step: linearise, solve, try, accept what lowers the cost.

    Steps too small for their decrease to show above rounding are accepted too. The end is a step whose predicted and
    actual decrease are below `rtol` of the cost, or after which that little is left to gain: while the model predicts
    well and decreases shrink tenfold or faster, they are taken to go on shrinking at that rate, but not more than a
    hundredfold a step.
    """

    rtol: Any
    atol: float
    norm: Any = eqx.field(static=True)
    max_steps: Any
    edges: _Edges
    structure: Structure
    width: Width
    group: str = eqx.field(static=True)
    kernel: Kernel = eqx.field(static=True)
    report: Any = eqx.field(static=True)

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        """Half the cost at the start."""
        del fn, args, options, f_struct, aux_struct, tags
        return self.begin(y, squared_residuals(self.edges.graph(y, self.group), y))

    def begin(self, y: Float[Array, "N P"], squared: Float[Array, " E"]) -> _State:
        """The state at `y`, of which the squared residuals are given."""
        half = self._half(squared)
        largest = jnp.max(jnp.abs(y), initial=1)
        traces = jnp.trace(self.edges.information, axis1=1, axis2=2)
        floor = jnp.sum(traces) * (jnp.finfo(y.dtype).eps * largest) ** 2
        damping, decrease = jnp.asarray(_FIRST_DAMPING, half.dtype), jnp.zeros((), half.dtype)
        status = jnp.where(jnp.isfinite(half), jnp.where(half > 0, _RUNNING, 0), 3)
        none = jnp.zeros((), jnp.int32)
        return _State(floor, jnp.asarray(False), half, half, decrease, damping, none, status.astype(jnp.int32), none)

    def _half(self, squared):
        return jnp.sum(jnp.where(self.edges.robust, rho(self.kernel, squared, self.width), squared)) / 2

    def linearise(self, y: Float[Array, "N P"], state: _State) -> tuple[System, Float[Array, "N d"]]:
        """H + damping I and the gradient of half the cost."""
        graph = self.edges.graph(y, self.group)
        blocks = gauss_newton_blocks(graph, y, self.kernel, self.width, state.late)
        system, gradient = assemble(graph, self.structure.pattern, blocks, self.structure.free)
        running = state.status == _RUNNING  # in a batch the finished ones are carried along: NaN spares their factor
        return damped(system, jnp.where(running, state.damping, jnp.nan)), gradient

    def accept(
        self,
        y: Float[Array, "N P"],
        state: _State,
        gradient: Float[Array, "N d"],
        delta: Float[Array, "N d"],
        trial: Float[Array, "N P"],
        squared: Float[Array, " E"],
    ) -> tuple[Float[Array, "N P"], _State, Tried]:
        """The next iterate, the next state, and what to report of a step to `trial`, with its squared residuals."""
        predicted = -jnp.sum(delta * gradient) / 2
        half = self._half(squared)
        eps = jnp.finfo(half.dtype).eps * (1e5 if half.dtype == jnp.float64 else 0)
        noise = state.floor + eps * state.half
        accept = (half <= state.half) | ((predicted <= noise) & (half <= state.half + noise))
        decrease = state.half - half
        limit = self.rtol * state.half + state.floor
        small = accept & (decrease <= limit) & (predicted <= limit)
        rate = decrease / state.decrease
        left = decrease * jnp.maximum(rate, _FASTEST_RATE) / (1 - rate)
        small |= accept & (rate >= 0) & (rate < 0.1) & (left <= limit) & (jnp.abs(predicted - decrease) < predicted / 2)
        well = jnp.where(decrease > 0.75 * predicted, 0.1, jnp.where(decrease > 0.25 * predicted, 1, 4))
        # A step refused with the kernel's curvature is tried again without it, at the same damping.
        refused = jnp.where(accept | state.late, 0, state.refused + 1)
        poorly = jnp.where(state.late, 1, 10.0 ** jnp.maximum(refused - 1, 1))
        change = jnp.where(accept, well, poorly).astype(half.dtype)
        damping = jnp.maximum(state.damping * change, _SMALLEST_DAMPING)
        status = jnp.where(damping > _LARGEST_DAMPING, 2, _RUNNING)
        status = jnp.where(small | (half == 0), 0, status).astype(jnp.int32)
        new = _State(
            state.floor,
            accept & (predicted < _LATE * half),
            jnp.where(accept, half, state.half),
            state.initial,
            jnp.where(accept, decrease, state.decrease),
            damping,
            refused.astype(jnp.int32),
            status,
            state.steps + 1,
        )
        return jnp.where(accept, trial, y), new, Tried(new.steps, 2 * half, accept, state.damping)

    def step(self, fn, y, args, options, state, tags):
        """Returns the next iterate, the next state, and nothing else."""
        del fn, args, options, tags
        system, gradient = self.linearise(y, state)
        delta = linear_solve(self.structure, system, -gradient)
        y, new, tried = self.accept(y, state, gradient, delta, *moved(self.edges.graph(y, self.group), y, delta))
        if self.report is not None:
            jax.debug.callback(self.report, *tried)
        return y, new, None

    def terminate(self, fn, y, args, options, state, tags):
        """Whether a status other than running is reached, or all steps are used up."""
        del fn, y, args, options, tags
        return (state.status != _RUNNING) | (state.steps >= self.max_steps), optx.RESULTS.successful

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        """Nothing to do."""
        del fn, args, options, state, tags, result
        return y, aux, {}


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Solution:
    """What `solve` returns; under vmap with the batch in front.

    Attributes:
      poses: the optimised poses, angles wrapped, quaternions of unit length.
      cost: sum of rho at `poses`.
      initial_cost: the same at the starting point.
      iterations: steps tried, accepted or not.
      status: index into `STATUS`; 0 is converged.
    """

    poses: Float[Array, "*n N P"]
    cost: Float[Array, "*n"]
    initial_cost: Float[Array, "*n"]
    iterations: Int[Array, "*n"]
    status: Int[Array, "*n"]


def moved(
    graph: PoseGraph, poses: Float[Array, "N P"], delta: Float[Array, "N d"]
) -> tuple[Float[Array, "N P"], Float[Array, " E"]]:
    """The poses after a step, and the squared residuals there."""
    trial = graph.lie.compose(poses, graph.lie.exp(delta))
    return trial, squared_residuals(graph, trial)


Report = Callable[[Any, Any, Any, Any], None]
"""Called after a step with what `Tried` has: numbers, as arrays or as Python's."""


def levenberg(
    graph: PoseGraph,
    structure: Structure,
    kernel: Kernel,
    width: Width,
    max_steps: int | Int[Array | np.ndarray, ""],
    rtol: float | Float[Array | np.ndarray, ""],
    report: Report | None = None,
) -> Levenberg:
    """The solver of a graph; all but `kernel` and `report` may be traced."""
    edges = _Edges(graph.i, graph.j, graph.measured, graph.information, graph.robust, graph.fixed, graph.position)
    return Levenberg(rtol, 0.0, optx.max_norm, max_steps, edges, structure, width, graph.group, kernel, report)


def minimise(
    graph: PoseGraph,
    structure: Structure,
    kernel: Kernel,
    width: Width,
    max_steps: int | Int[Array, ""],
    rtol: float | Float[Array, ""],
    report: Report | None = None,
) -> Solution:
    """Runs the loop; all but `kernel` may be traced. Not differentiable by itself: `adjoint.optimum` is."""
    graph = jax.tree.map(jnp.asarray, graph)
    start = graph.lie.normalise(graph.poses)
    limits = jnp.asarray(max_steps, jnp.int32), jnp.asarray(rtol, start.dtype)
    solver = levenberg(graph, structure, kernel, width, *limits, report)

    def residual(y, args):
        edges, width = args
        return jnp.sqrt(edge_costs(edges.graph(y, graph.group), y, kernel, width))

    args = (solver.edges, width)
    found: optx.Solution = optx.least_squares(residual, solver, start, args, max_steps=None, throw=False)
    return solution(graph, found.value, found.state)


def solution(graph: PoseGraph, poses: Float[Array, "N P"], state: _State) -> Solution:
    """What the loop found; `graph` has the poses it began with."""
    poses = jnp.where(graph.fixed[:, None], graph.poses, graph.lie.normalise(poses))
    return Solution(poses, 2 * state.half, 2 * state.initial, state.steps, state.status)
