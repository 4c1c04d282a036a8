"""Pose-graph optimisation: Levenberg-Marquardt of optimistix with a sparse step on the manifold.

Minimises sum_k rho(r_k^T information_k r_k) (Early Bird, section III-D, with Cauchy's rho). Optimistix runs the outer
loop; `_SparseDescent` assembles the block Hessian once per accepted step and solves H + damping I; damping starts at
1e-5 and moves by factors of ten; the loop ends after a step whose predicted and actual decrease are below `rtol`.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float, Int

from ebjax.geometry.lie import GROUPS
from ebjax.posegraph.assembly import assemble, damped
from ebjax.posegraph.factors import edge_costs, gauss_newton_blocks
from ebjax.posegraph.graph import PoseGraph
from ebjax.posegraph.linear import Structure, linear_solve

STATUS = ("converged", "steps used up", "stalled at the largest damping", "not finite")
_LARGEST_DAMPING = 1e12
_LATE = 1e-4  # predicted relative decrease below which the kernel's curvature enters: earlier it costs rejected steps


class _Edges(NamedTuple):
    """A graph without its poses: what travels through optimistix, which may put other things in place of arrays."""

    i: Array
    j: Array
    measured: Array
    information: Array
    robust: Array
    fixed: Array

    def graph(self, poses, group):
        return PoseGraph(poses, self.i, self.j, self.measured, self.information, self.robust, self.fixed, group)


class _SparseDescent(optx.AbstractDescent):
    """Levenberg-Marquardt step from the graph's own blocks; `step` returns retract(y, delta) - y.

    The iterate is (poses, predicted decrease of the cost by the step that led there): the only way for a descent to
    tell the search how small its step was.
    """

    edges: _Edges
    structure: Structure
    width: Float[Array, ""]
    group: str = eqx.field(static=True)
    kernel: str = eqx.field(static=True)

    def _linearise(self, poses, bent):
        graph = self.edges.graph(poses, self.group)
        blocks = gauss_newton_blocks(graph, poses, self.kernel, self.width, bent)
        return assemble(graph, self.structure.pattern, blocks, ~self.edges.fixed)

    def init(self, y, f_info_struct):
        del f_info_struct
        return (y, *jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(self._linearise, y[0], False)))

    def query(self, y, f_info, state):
        del state
        late = (y[1] >= 0) & (y[1] < _LATE * f_info.as_min())
        return (y, *self._linearise(y[0], late))

    def step(self, step_size, state):
        (poses, before), system, gradient = state
        delta = linear_solve(self.structure, damped(system, 1 / step_size), -gradient)
        lie = GROUPS[self.group]
        predicted = -jnp.sum(delta * gradient) / 2
        return (lie.compose(poses, lie.exp(delta)) - poses, predicted - before), optx.RESULTS.successful


class _Decrease(optx.AbstractSearch[Any, Any, Any, Any]):
    """Accepts what lowers the cost, and steps too small for their decrease to show above rounding.

    State: step size = 1 / damping, which moves by factors of ten, and the first cost. `floor` is what rounding of the
    poses alone makes of the cost.
    """

    floor: Float[Array, ""]

    def init(self, y, f_info_struct):
        del f_info_struct
        return jnp.asarray(1e5, y[1].dtype), jnp.zeros((), y[1].dtype)

    def step(self, first_step, y, y_eval, f_info, f_eval_info, state):
        size, initial = state
        cost, before = f_eval_info.as_min(), f_info.as_min()
        noise = self.floor + jnp.finfo(size.dtype).eps * (1e5 if size.dtype == jnp.float64 else 0) * before
        accept = first_step | (cost <= before) | ((y_eval[1] <= noise) & (cost <= before + noise))
        size = jnp.where(first_step, size, jnp.where(accept, size * 10, size / 10))
        return size, accept, optx.RESULTS.successful, (size, jnp.where(first_step, cost, initial))


class _Levenberg(optx.AbstractGaussNewton):
    """Optimistix's Gauss-Newton loop with the descent and search above, and a stop on the relative decrease."""

    rtol: float
    atol: float
    norm: Any = eqx.field(static=True)
    descent: _SparseDescent
    search: _Decrease
    verbose: Any = eqx.field(static=True)

    def step(self, fn, y, args, options, state, tags):
        new_y, new, aux = super().step(fn, y, args, options, state, tags)
        before, after, predicted = _half(state), _half(new), new_y[1]
        accepted = new.num_steps_since_acceptance == 0
        limit = self.rtol * before + self.search.floor
        small = accepted & ~state.first_step & (before - after <= limit) & (predicted <= limit)
        stuck = new.search_state[0] < 1 / _LARGEST_DAMPING
        terminate = small | stuck | ~jnp.isfinite(after) | (after == 0)
        return new_y, eqx.tree_at(lambda s: s.terminate, new, terminate), aux


def _half(state: Any) -> Array:
    """Half the cost at the last accepted iterate."""
    return state.f_info.as_min()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Solution:
    """What `solve` returns.

    Attributes:
      poses: the optimised poses, angles wrapped, quaternions of unit length.
      cost: sum of rho at `poses`.
      initial_cost: the same at the starting point.
      iterations: steps tried, accepted or not.
      status: index into `STATUS`; 0 is converged.
    """

    poses: Float[Array, "N P"]
    cost: Float[Array, ""]
    initial_cost: Float[Array, ""]
    iterations: Int[Array, ""]
    status: Int[Array, ""]


def minimise(
    graph: PoseGraph, structure: Structure, kernel: str, width: Float[Array, ""], max_steps: int, rtol: float
) -> Solution:
    """Runs the loop; `i`, `j` may be traced here. Not differentiable by itself: `adjoint.optimum` is."""
    lie = graph.lie
    parts = (graph.i, graph.j, graph.measured, graph.information, graph.robust, graph.fixed)
    edges = _Edges(*(jnp.asarray(x) for x in parts))
    start = lie.normalise(jnp.asarray(graph.poses))

    def residual(y, args):
        edges, width = args
        costs = edge_costs(edges.graph(y[0], graph.group), y[0], kernel, width)
        return jax.lax.stop_gradient(jnp.sqrt(costs))

    largest = jnp.max(jnp.abs(start), initial=1)
    traces = jnp.trace(edges.information, axis1=1, axis2=2)
    floor = jnp.sum(traces) * (jnp.finfo(start.dtype).eps * largest) ** 2
    y0 = (start, jnp.full((), -1, start.dtype))
    descent = _SparseDescent(edges, structure, width, graph.group, kernel)
    solver = _Levenberg(rtol, 0.0, optx.max_norm, descent, _Decrease(floor), lambda **_: None)
    found: optx.Solution = optx.least_squares(
        residual, solver, y0, (edges, width), max_steps=max_steps + 1, throw=False
    )
    state = found.state
    size, initial = state.search_state
    cost = 2 * _half(state)
    status = jnp.where(state.terminate, 0, 1)
    status = jnp.where(size < 1 / _LARGEST_DAMPING, 2, status)
    status = jnp.where(jnp.isfinite(cost), status, 3)
    poses = jnp.where(edges.fixed[:, None], graph.poses, lie.normalise(found.value[0]))
    return Solution(poses, cost, 2 * initial, state.num_steps - 1, status)
