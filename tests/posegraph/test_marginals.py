from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.posegraph import add_priors, marginals, solve
from ebjax.posegraph.factors import edge_residual


@pytest.mark.parametrize("solver", ["elimination", "qdldl", "supernodal", "cholmod"])
@pytest.mark.parametrize("group", ["se2", "se3"])
def test_blocks_of_the_inverse_hessian(ring, group, solver):
    if solver == "cholmod":
        pytest.importorskip("cvxopt")
    graph, truth = ring(group, n=24, loops=3, noise=0.0)
    lie, n = graph.lie, 24

    def residual(delta):
        delta = jnp.concatenate([jnp.zeros((1, lie.dim)), delta.reshape(n - 1, lie.dim)])
        poses = lie.compose(truth, lie.exp(delta))
        return edge_residual(group, poses[graph.i], poses[graph.j], graph.measured)

    j = np.asarray(jax.jit(jax.jacfwd(residual))(jnp.zeros((n - 1) * lie.dim)))
    inverse = np.linalg.inv(np.einsum("eki,ekl,elj->ij", j, np.asarray(graph.information), j))
    rows = np.array([0, 5, 23, 5])
    found = marginals(replace(graph, poses=truth), rows, kernel="none", solver=solver)
    np.testing.assert_array_equal(found[0], 0)
    for row, block in zip(rows[1:], found[1:], strict=True):
        at = slice((row - 1) * lie.dim, row * lie.dim)
        np.testing.assert_allclose(block, inverse[at, at], rtol=1e-6, atol=1e-12)


def test_rows_outside_the_graph_are_refused(ring):
    with pytest.raises(ValueError, match="0 to 59; got 3 to 60"):
        marginals(ring()[0], np.array([3, 60]))
    with pytest.raises(ValueError, match="choose one of"):
        marginals(ring()[0], np.array([3]), kernel="tukey")


@pytest.mark.parametrize("group", ["se2", "se3"])
def test_a_prior_holds_its_pose_and_replaces_the_gauge(ring, group):
    graph, truth = ring(group, n=20, loops=2, noise=0.0)
    lie = graph.lie
    away = lie.compose(truth[7:8], lie.exp(jnp.full((1, lie.dim), 0.3)))
    held = add_priors(graph, np.array([7]), away, 100 * np.eye(lie.dim)[None])
    solution = solve(held, kernel="none")
    assert solution.poses.shape[0] == 21
    np.testing.assert_allclose(lie.log(lie.compose(lie.inverse(away[0]), solution.poses[7])), 0, atol=1e-7)
    np.testing.assert_allclose(solution.poses[-1], np.array(lie.identity), atol=0)
    assert float(solution.cost) < 1e-10
    spread = marginals(replace(held, poses=solution.poses), np.array([7]), kernel="none")
    np.testing.assert_allclose(spread[0], np.eye(lie.dim) / 100, rtol=1e-5, atol=1e-9)
