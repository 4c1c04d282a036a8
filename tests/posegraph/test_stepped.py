"""Steps from the host against the one program; graphs filled up to a capacity, and the programs they share."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.posegraph import analyse, marginals, solve, stepped
from ebjax.posegraph.capacity import at_capacity, capacities, capacity, concrete, room_for
from ebjax.posegraph.lm import _prepared, _solve, cut_off
from ebjax.posegraph.marginals import relative_marginals
from ebjax.posegraph.warm import compile_solve_for

PLANAR = ["none", "cauchy", "huber", "geman-mcclure", "dcs", "tls", "gnc-tls", "gnc-gm", "pcm", "consensus"]
SPATIAL = ["cauchy", "tls", "consensus"]
CASES = [("se2", kernel) for kernel in PLANAR] + [("se3", kernel) for kernel in SPATIAL]


def in_one_program(graph, kernel, **options):
    limits = {"max_steps": 200, "rtol": 1e-9} | options
    return _solve(
        *_prepared(graph, kernel, None, "auto", None), group=graph.group, kernel=kernel, report=None, **limits
    )


def agree(one, other, tolerance=1e-12):
    np.testing.assert_allclose(one.poses, other.poses, atol=tolerance, rtol=0)
    np.testing.assert_allclose(one.cost, other.cost, rtol=tolerance, atol=1e-20)
    np.testing.assert_allclose(one.initial_cost, other.initial_cost, rtol=tolerance, atol=1e-20)
    assert int(one.iterations) == int(other.iterations) and int(one.status) == int(other.status)


@pytest.mark.slow
@pytest.mark.parametrize("group, kernel", CASES)
def test_from_the_host_as_in_one_program(ring, group, kernel):
    graph, _ = ring(group, n=40, false_loops=2)
    graph = replace(graph, fixed=np.isin(np.arange(40), [0, 17]))
    agree(solve(graph, kernel=kernel, max_steps=60), in_one_program(graph, kernel, max_steps=60))


@pytest.mark.slow
@pytest.mark.parametrize("group, priors, kernel", [("se2", "pose", "gnc-tls"), ("se3", "position", "tls")])
def test_with_landmarks_positions_and_priors(mapped, group, priors, kernel):
    graph, _ = mapped(group, priors=priors)
    agree(solve(graph, kernel=kernel, max_steps=60), in_one_program(graph, kernel, max_steps=60))


def test_derivatives_and_batches_take_the_one_program(ring):
    graph, _ = ring(n=20, loops=2)
    inside = jax.jit(lambda: solve(graph, kernel="none").poses)()
    np.testing.assert_allclose(inside, solve(graph, kernel="none").poses, atol=1e-12)
    assert concrete(graph)
    assert not jax.jit(lambda: jnp.asarray(concrete(graph)))()
    seen = []
    jax.grad(lambda m: seen.append(concrete(replace(graph, measured=m))) or jnp.sum(m))(graph.measured)
    assert seen == [False]


def test_the_report_names_every_step(ring):
    graph, _ = ring(false_loops=1)
    told = []
    found = solve(graph, report=lambda *step: told.append([float(x) for x in step]))
    assert [step[0] for step in told] == list(range(1, int(found.iterations) + 1))
    assert min(cost for _, cost, accepted, _ in told if accepted) == pytest.approx(float(found.cost))


@pytest.mark.parametrize("count, least", [(0, 64), (1, 64), (64, 64), (65, 128), (128, 128), (129, 256), (1000, 1024)])
def test_capacities_double(count, least):
    assert capacity(count, "closures") == least
    assert capacities(200, count) == (256, max(512, least))


def test_there_is_room_for_more_inside():
    with room_for(rows=300, closures=65):
        assert capacity(3, "rows") == 512 and capacity(3, "closures") == 128
        with room_for(rows=1, edges=2000):
            assert capacities(3, 3) == (512, 2048)
    assert capacity(3, "rows") == 256


@pytest.mark.slow
@pytest.mark.parametrize("group, kernel", [("se2", "consensus"), ("se2", "tls"), ("se3", "cauchy")])
def test_inert_rows_and_edges_change_nothing(ring, group, kernel):
    graph, _ = ring(group, n=40, false_loops=2)
    rows = np.array([3, 20, 39])
    little = solve(graph, kernel=kernel, max_steps=60)
    here = replace(graph, poses=np.asarray(little.poses))
    with room_for(rows=300, edges=1100, closures=90):
        agree(solve(graph, kernel=kernel, max_steps=60), little)
        cut = cut_off(graph, little.poses, kernel=kernel)
        spread = marginals(here, rows), relative_marginals(here, rows, rows[::-1])
    np.testing.assert_array_equal(cut, cut_off(graph, little.poses, kernel=kernel))
    np.testing.assert_allclose(spread[0], marginals(here, rows), rtol=1e-11, atol=1e-14)
    np.testing.assert_allclose(spread[1], relative_marginals(here, rows, rows[::-1]), rtol=1e-11, atol=1e-14)
    inside = jax.jit(lambda g, s: marginals(g, rows, structure=s))(here, analyse(here))
    np.testing.assert_allclose(spread[0], inside, rtol=1e-8, atol=1e-14)


def test_an_exact_fill_is_left_as_it_is(ring):
    graph, _ = ring(n=256, loops=257)
    full = at_capacity(graph)
    assert full.poses.shape == (256, 3) and full.i.shape == (512,)
    np.testing.assert_array_equal(full.measured, graph.measured)


@pytest.mark.slow
@pytest.mark.parametrize("group", ["se2", "se3"])
def test_graphs_of_one_capacity_compile_once(ring, group, counted):
    graphs = [jax.tree.map(np.asarray, ring(group, n=n, loops=loops)[0]) for n, loops in ((60, 5), (77, 12), (31, 3))]

    def answered(graph):
        poses = np.asarray(solve(graph, kernel="consensus").poses)
        cut_off(graph, poses, kernel="consensus")
        marginals(replace(graph, poses=poses), np.array([3, 7]), kernel="consensus")

    answered(graphs[0])
    with counted() as programs:
        for graph in graphs:
            answered(graph)
    assert not programs.asked
    assert len(graphs[1].poses) == 77


def test_what_is_to_come_is_made_before(ring, counted):
    compile_solve_for(300, kernel="tls")
    graph = jax.tree.map(np.asarray, ring(n=270, loops=300)[0])
    with counted() as programs:
        found = solve(graph, kernel="tls")
    assert not programs.asked
    assert found.poses.shape == (270, 3)


def test_the_squared_residuals_are_those_of_the_graph(ring):
    graph, _ = ring(n=20)
    full = at_capacity(graph)
    squared = np.asarray(stepped.squared_residuals(full, full.poses))
    assert not squared[len(graph.i) :].any()
    assert squared[: len(graph.i)].any()
