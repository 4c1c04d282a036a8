from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.posegraph import STATUS, analyse, solve
from ebjax.posegraph.factors import squared_residuals
from ebjax.posegraph.falseloops import add_false_loops, error_m, loops_of

KERNELS = ("gnc-tls", "gnc-gm")


@pytest.fixture(name="spoilt")
def _spoilt(ring):
    """A ring with ten right loops and ten false ones, robust on loops, from odometry; and the clean solution."""

    def make(group="se2", share=0.5, seed=0):
        clean, _ = ring(group, n=80, loops=10, noise=0.01, seed=seed)
        clean = replace(clean, robust=loops_of(clean))
        return add_false_loops(clean, share, seed=seed), solve(clean, kernel="none").poses

    return make


@pytest.mark.slow
@pytest.mark.parametrize("group", ["se2", "se3"])
@pytest.mark.parametrize("kernel", KERNELS)
def test_half_of_the_loops_may_be_false(spoilt, group, kernel):
    graph, clean = spoilt(group)
    found = solve(graph, kernel=kernel)
    assert STATUS[int(found.status)] == "converged"
    # Least squares without the false loops is found again, all but what gnc-gm's soft weights make of the right ones.
    assert error_m(found.poses, clean, group) < (1e-6 if kernel == "gnc-tls" else 0.02)
    assert error_m(solve(graph, kernel="none").poses, clean, group) > 0.2


def test_tls_of_a_clean_graph_is_least_squares(ring):
    graph, _ = ring(noise=0.01)
    graph = replace(graph, robust=loops_of(graph))
    np.testing.assert_allclose(solve(graph, kernel="gnc-tls").poses, solve(graph, kernel="none").poses, atol=1e-7)


def test_all_loops_false_costs_no_more_than_odometry(ring):
    graph, _ = ring(loops=6, false_loops=6, noise=0.001)
    found = solve(replace(graph, robust=loops_of(graph)), kernel="gnc-tls")
    assert float(found.cost) < 6 * 16.27
    # A loop that the odometry allows for may be met; those that are not are out of it.
    s = np.asarray(squared_residuals(graph, found.poses))[59:]
    assert ((s < 16.27) | (s > 100)).all()


@pytest.mark.parametrize("kernel", KERNELS)
def test_nothing_robust_is_least_squares(ring, kernel):
    graph, _ = ring()
    graph = replace(graph, robust=np.zeros(len(graph.i), bool))
    np.testing.assert_allclose(solve(graph, kernel=kernel).poses, solve(graph, kernel="none").poses, atol=1e-9)


def test_pieces_that_only_false_loops_join_stay_where_they_are(ring):
    graph, _ = ring(n=40, loops=0)
    keep = np.arange(39) != 20  # two pieces, and loops between them that contradict each other
    i, j = np.append(np.asarray(graph.i)[keep], [2, 8]), np.append(np.asarray(graph.j)[keep], [30, 35])
    measured = np.concatenate([np.asarray(graph.measured)[keep], [[50.0, 0, 0], [-50.0, 0, 0]]])
    information = np.concatenate([np.asarray(graph.information)[keep], np.tile(500 * np.eye(3), (2, 1, 1))])
    torn = replace(graph, i=i, j=j, measured=measured, information=information, robust=np.abs(i - j) > 1)
    found = solve(torn, kernel="gnc-tls")
    assert np.isfinite(np.asarray(found.poses)).all()


def test_width_zero_takes_an_edge_out(spoilt):
    graph, clean = spoilt()
    width = np.where(np.arange(len(graph.i)) < 89, 4.0, 0.0)
    found = solve(graph, kernel="gnc-tls", width=width)
    assert error_m(found.poses, clean, "se2") < 1e-6


@pytest.mark.slow
def test_gradient_is_that_of_least_squares_on_the_inliers(spoilt, only):
    graph, _ = spoilt()

    true = np.arange(len(graph.i)) < 89

    def gradient(graph, kernel):
        def spread(measured):
            return jnp.sum(solve(replace(graph, measured=measured), kernel=kernel, rtol=1e-20).poses[:, :2] ** 2)

        return jax.grad(spread)(jnp.asarray(graph.measured))

    ours, theirs = gradient(graph, "gnc-tls"), gradient(only(graph, true), "none")
    np.testing.assert_allclose(ours[true], theirs, rtol=1e-5, atol=1e-6 * float(abs(theirs).max()))
    np.testing.assert_array_equal(ours[~true], 0)


def test_runs_under_jit_and_vmap(spoilt):
    graph, _ = spoilt()
    structure = analyse(graph)
    noise = jnp.asarray(np.random.default_rng(0).normal(size=(2, *graph.measured.shape)) * 1e-3)
    batch = jnp.asarray(graph.measured)[None] + noise
    one = lambda measured: solve(replace(graph, measured=measured), kernel="gnc-tls", structure=structure).poses  # noqa: E731
    together = jax.jit(jax.vmap(one))(batch)
    np.testing.assert_allclose(together[1], one(batch[1]), atol=1e-6)
