import functools
from copy import copy
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from ebjax.geometry import se2
from ebjax.posegraph import STATUS, analyse, make_graph, solve
from ebjax.posegraph.factors import edge_costs


@pytest.fixture(scope="module")
def optimum(ring):
    """Returns a function: the cost that SciPy finds for a kernel on `ring(n=30, loops=4, false_loops=1)`."""

    @functools.cache
    def found(kernel):
        graph, _ = ring(n=30, loops=4, false_loops=1)

        def cost(free):
            poses = jnp.concatenate([graph.poses[:1], free.reshape(-1, 3)])
            return jnp.sum(edge_costs(graph, poses, kernel, jnp.asarray(1.0)))

        start = np.asarray(solve(graph, kernel=kernel).poses[1:]).ravel() + 1e-3
        value, slope, hessian = (jax.jit(f) for f in (cost, jax.grad(cost), jax.hessian(cost)))
        return scipy.optimize.minimize(value, start, jac=slope, hess=hessian, method="trust-exact").fun

    return found


@pytest.mark.slow
@pytest.mark.parametrize("kernel", ["none", "cauchy"])
@pytest.mark.parametrize("solver", ["elimination", "qdldl", "supernodal", "cholmod"])
def test_reaches_the_optimum_of_scipy(ring, optimum, kernel, solver):
    if solver == "cholmod":
        pytest.importorskip("cvxopt")
    graph, _ = ring(n=30, loops=4, false_loops=1)
    solution = solve(graph, kernel=kernel, solver=solver)
    assert STATUS[int(solution.status)] == "converged"
    assert float(solution.cost) == pytest.approx(optimum(kernel), rel=1e-8)
    assert float(solution.cost) < float(solution.initial_cost)
    np.testing.assert_array_equal(solution.poses[0], graph.poses[0])


@pytest.mark.slow
@pytest.mark.parametrize("group", ["se2", "se3"])
def test_perfect_measurements_give_the_truth(ring, group):
    graph, truth = ring(group, noise=0.0, n=40)
    rng, lie = np.random.default_rng(0), graph.lie
    shaken = lie.compose(truth, lie.exp(jnp.asarray(0.05 * rng.normal(size=(40, lie.dim)))))
    solution = solve(replace(graph, poses=shaken.at[0].set(truth[0])), kernel="none")
    error = lie.log(lie.compose(lie.inverse(truth), solution.poses))
    assert abs(error).max() < 1e-8
    assert int(solution.status) == 0


def test_the_solution_does_not_depend_on_the_frame(ring):
    graph, _ = ring(false_loops=1)
    move = jnp.broadcast_to(jnp.array([5.0, -3.0, 2.5]), graph.poses.shape)
    there = solve(replace(graph, poses=se2.compose(move, graph.poses))).poses
    here = solve(graph).poses
    relative = lambda poses: se2.compose(se2.inverse(poses[:-1]), poses[1:])  # noqa: E731
    np.testing.assert_allclose(relative(there), relative(here), atol=1e-6)


def test_a_float64_graph_is_not_solved_in_single_precision(ring):
    graph, _ = ring()
    with jax.enable_x64(False), pytest.raises(ValueError, match=r"float64 and JAX in float32.*setup_jax"):
        solve(jax.tree.map(np.asarray, graph))


def test_columns_of_other_lengths_are_refused(ring):
    graph, _ = ring()
    for name in ("j", "robust", "fixed"):
        shorter = copy(graph)
        object.__setattr__(shorter, name, np.asarray(getattr(graph, name))[:-1])  # past the tests' own type checks
        with pytest.raises(ValueError, match=rf"{name} is \(\d+,\); give \(\d+,\)"):
            solve(shorter)


def test_float32_in_float32_out(ring):
    graph, _ = ring(dtype=jnp.float32)
    solution = solve(graph)
    assert solution.poses.dtype == solution.cost.dtype == jnp.float32
    assert float(solution.cost) == pytest.approx(float(solve(ring()[0]).cost), rel=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["elimination", "qdldl"])
def test_batches_by_vmap(ring, solver):
    graph, _ = ring(n=30, loops=3)
    shift = jnp.asarray(np.random.default_rng(0).normal(size=(3, *graph.measured.shape)) * 0.01)
    batch = graph.measured[None] + shift
    one = lambda measured: solve(replace(graph, measured=measured), solver=solver).poses  # noqa: E731
    together = jax.vmap(one)(batch)
    for poses, measured in zip(together, batch, strict=True):
        np.testing.assert_allclose(poses, one(measured), atol=1e-6)


def test_runs_inside_jit_with_the_structure_given(ring):
    graph, _ = ring(n=30, loops=3)
    structure = analyse(graph)
    inside = jax.jit(lambda g, s: solve(g, structure=s).poses)(graph, structure)
    np.testing.assert_allclose(inside, solve(graph).poses, atol=1e-10)
    with pytest.raises(ValueError, match="structure="):
        jax.jit(solve)(graph)


def test_every_piece_of_a_disconnected_graph_keeps_its_first_pose(ring):
    graph, _ = ring(n=30, loops=0)
    keep = np.asarray(graph.i) != 14
    cut = replace(
        graph,
        i=np.asarray(graph.i)[keep],
        j=np.asarray(graph.j)[keep],
        measured=graph.measured[keep],
        information=graph.information[keep],
        robust=np.asarray(graph.robust)[keep],
    )
    solution = solve(cut)
    np.testing.assert_array_equal(solution.poses[jnp.array([0, 15])], graph.poses[jnp.array([0, 15])])
    assert float(solution.cost) < 1e-12
    assert int(solution.status) == 0


def test_nothing_to_solve_is_returned_as_it_is():
    for n in (0, 1, 4):
        poses = np.arange(3.0 * n).reshape(n, 3)
        none = np.zeros(0, int)
        solution = solve(make_graph(poses, none, none, np.zeros((0, 3)), np.zeros((0, 3, 3))))
        np.testing.assert_array_equal(solution.poses, poses)
        assert float(solution.cost) == 0
        assert int(solution.status) == 0


def test_duplicate_edges_count_twice(ring):
    graph, _ = ring(n=12, loops=2)
    twice = make_graph(
        graph.poses,
        np.tile(graph.i, 2),
        np.tile(graph.j, 2),
        jnp.tile(graph.measured, (2, 1)),
        jnp.tile(graph.information, (2, 1, 1)),
    )
    assert float(solve(twice).cost) == pytest.approx(2 * float(solve(graph).cost), rel=1e-9)


def test_too_few_steps_are_a_status(ring):
    graph, _ = ring(false_loops=2, loops=6)
    solution = solve(graph, max_steps=1)
    assert STATUS[int(solution.status)] == "steps used up"
    assert float(solution.cost) <= float(solution.initial_cost)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [("measured", np.nan, "measured row 3 is not finite"), ("information", -1.0, "edge 3 is not positive definite")],
)
def test_bad_numbers_are_refused(ring, field, value, message):
    graph, _ = ring(n=12, loops=2)
    bad = np.array(getattr(graph, field))
    bad[3] = value
    with pytest.raises(ValueError, match=message):
        solve(replace(graph, **{field: bad}))
    with pytest.raises(ValueError, match="choose one of"):
        solve(graph, kernel="tukey")
