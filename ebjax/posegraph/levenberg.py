"""Pose-graph optimisation: Levenberg-Marquardt on the manifold with a sparse step, run by optimistix.

Minimises sum_k rho(r_k^T information_k r_k) (Early Bird, section III-D, with Cauchy's rho). A step solves
(H + damping I) delta = -gradient with the graph's own blocks, where optimistix's LevenbergMarquardt would build a
dense or matrix-free Jacobian. Damping starts at 1e-5; it falls tenfold after a step that gains at least three
quarters of what was predicted and grows fourfold after one that gains less than a quarter, tenfold after one that is
refused, and faster when several are.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from ebjax.geometry.lie import GROUPS
from ebjax.posegraph.assembly import assemble, damped
from ebjax.posegraph.factors import edge_costs, gauss_newton_blocks
from ebjax.posegraph.graph import PoseGraph
from ebjax.posegraph.linear import Structure, linear_solve
from ebjax.posegraph.robust import Width

STATUS = ("converged", "steps used up", "stalled at the largest damping", "not finite")
_RUNNING = 1
_FIRST_DAMPING = 1e-5
_SMALLEST_DAMPING, _LARGEST_DAMPING = 1e-12, 1e12
_FASTEST_RATE = 0.01
_LATE = 1e-4  # predicted relative decrease below which the kernel's curvature enters: earlier it costs rejected steps


class _Edges(NamedTuple):
    """A graph without its poses: what travels through optimistix, which may put other things in place of arrays."""

    i: Array
    j: Array
    measured: Array
    information: Array
    robust: Array
    fixed: Array
    position: Array | None

    def graph(self, poses, group):
        return PoseGraph(poses, *self[:-1], group, self.position)


class _State(NamedTuple):
    """`half` is half the cost of the iterate, `initial` of the start, `decrease` what the last accepted step gained.

    `refused` counts the steps refused since.
    """

    late: Bool[Array, ""]
    half: Float[Array, ""]
    initial: Float[Array, ""]
    decrease: Float[Array, ""]
    damping: Float[Array, ""]
    refused: Int[Array, ""]
    status: Int[Array, ""]
    steps: Int[Array, ""]


class _Levenberg(optx.AbstractLeastSquaresSolver):
    """One step: linearise, solve, try, accept what lowers the cost.

    Steps too small for their decrease to show above rounding are accepted too; `floor` is what rounding of the poses
    alone makes of half the cost. The end is a step whose predicted and actual decrease are below `rtol` of the cost, or
    after which that little is left to gain: while the model predicts well and decreases shrink tenfold or faster,
    they are taken to go on shrinking at that rate, but not more than a hundredfold a step.
    """

    rtol: Any
    atol: float
    norm: Any = eqx.field(static=True)
    max_steps: Any
    edges: _Edges
    structure: Structure
    width: Width
    floor: Float[Array, ""]
    group: str = eqx.field(static=True)
    kernel: str = eqx.field(static=True)
    report: Any = eqx.field(static=True)

    def _linearise(self, poses, late):
        graph = self.edges.graph(poses, self.group)
        blocks = gauss_newton_blocks(graph, poses, self.kernel, self.width, late)
        return assemble(graph, self.structure.pattern, blocks, self.structure.free)

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        """Half the cost at the start."""
        del options, f_struct, aux_struct, tags
        half = _half(fn, y, args)
        damping, decrease = jnp.asarray(_FIRST_DAMPING, half.dtype), jnp.zeros((), half.dtype)
        status = jnp.where(jnp.isfinite(half), jnp.where(half > 0, _RUNNING, 0), 3)
        none = jnp.zeros((), jnp.int32)
        return _State(jnp.asarray(False), half, half, decrease, damping, none, status.astype(jnp.int32), none)

    def step(self, fn, y, args, options, state, tags):
        """Returns the next iterate, the next state, and nothing else."""
        del options, tags
        system, gradient = self._linearise(y, state.late)
        running = state.status == _RUNNING  # in a batch the finished ones are carried along: NaN spares their factor
        delta = linear_solve(self.structure, damped(system, jnp.where(running, state.damping, jnp.nan)), -gradient)
        predicted = -jnp.sum(delta * gradient) / 2
        lie = GROUPS[self.group]
        trial = lie.compose(y, lie.exp(delta))
        half = _half(fn, trial, args)
        eps = jnp.finfo(half.dtype).eps * (1e5 if half.dtype == jnp.float64 else 0)
        noise = self.floor + eps * state.half
        accept = (half <= state.half) | ((predicted <= noise) & (half <= state.half + noise))
        decrease = state.half - half
        limit = self.rtol * state.half + self.floor
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
            accept & (predicted < _LATE * half),
            jnp.where(accept, half, state.half),
            state.initial,
            jnp.where(accept, decrease, state.decrease),
            damping,
            refused.astype(jnp.int32),
            status,
            state.steps + 1,
        )
        if self.report is not None:
            jax.debug.callback(self.report, new.steps, 2 * half, accept, state.damping)
        return jnp.where(accept, trial, y), new, None

    def terminate(self, fn, y, args, options, state, tags):
        """Whether a status other than running is reached, or all steps are used up."""
        del fn, y, args, options, tags
        return (state.status != _RUNNING) | (state.steps >= self.max_steps), optx.RESULTS.successful

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        """Nothing to do."""
        del fn, args, options, state, tags, result
        return y, aux, {}


def _half(fn, y, args):
    return jnp.sum(fn(y, args)[0] ** 2) / 2


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


def minimise(
    graph: PoseGraph,
    structure: Structure,
    kernel: str,
    width: Width,
    max_steps: int | Int[Array, ""],
    rtol: float | Float[Array, ""],
    report: Any = None,
) -> Solution:
    """Runs the loop; all but `kernel` may be traced. Not differentiable by itself: `adjoint.optimum` is."""
    lie = graph.lie
    parts = (graph.i, graph.j, graph.measured, graph.information, graph.robust, graph.fixed)
    position = None if graph.position is None else jnp.asarray(graph.position)
    edges = _Edges._make([*map(jnp.asarray, parts), position])
    start = lie.normalise(jnp.asarray(graph.poses))

    def residual(y, args):
        edges, width = args
        return jnp.sqrt(edge_costs(edges.graph(y, graph.group), y, kernel, width))

    largest = jnp.max(jnp.abs(start), initial=1)
    traces = jnp.trace(edges.information, axis1=1, axis2=2)
    floor = jnp.sum(traces) * (jnp.finfo(start.dtype).eps * largest) ** 2
    limits = (jnp.asarray(rtol, start.dtype), 0.0, optx.max_norm, jnp.asarray(max_steps, jnp.int32))
    solver = _Levenberg(*limits, edges, structure, width, floor, graph.group, kernel, report)
    found: optx.Solution = optx.least_squares(residual, solver, start, (edges, width), max_steps=None, throw=False)
    state = found.state
    poses = jnp.where(edges.fixed[:, None], graph.poses, lie.normalise(found.value))
    return Solution(poses, 2 * state.half, 2 * state.initial, state.steps, state.status)
