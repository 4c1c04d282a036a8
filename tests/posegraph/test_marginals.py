from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.posegraph import add_priors, marginals, solve
from ebjax.posegraph.factors import edge_residual
from ebjax.posegraph.marginals import relative_marginals

PAIRS = np.array([[0, 7], [7, 0], [5, 23], [3, 4], [9, 9], *[[k % 24, (5 * k + 1) % 24] for k in range(40)]])


def dense_inverse(graph, poses):
    """The inverse of the Gauss-Newton matrix by autodiff, rows and columns of the fixed first pose zero."""
    lie, n = graph.lie, len(poses)

    def residual(delta):
        delta = jnp.concatenate([jnp.zeros((1, lie.dim)), delta.reshape(n - 1, lie.dim)])
        moved = lie.compose(poses, lie.exp(delta))
        return edge_residual(graph.group, moved[graph.i], moved[graph.j], graph.measured)

    j = np.asarray(jax.jit(jax.jacfwd(residual))(jnp.zeros((n - 1) * lie.dim)))
    inverse = np.zeros((n * lie.dim, n * lie.dim))
    inverse[lie.dim :, lie.dim :] = np.linalg.inv(np.einsum("eki,ekl,elj->ij", j, np.asarray(graph.information), j))
    return inverse


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["elimination", "qdldl", "supernodal", "cholmod"])
@pytest.mark.parametrize("group", ["se2", "se3"])
def test_blocks_of_the_inverse_hessian(ring, group, solver):
    if solver == "cholmod":
        pytest.importorskip("cvxopt")
    graph, truth = ring(group, n=24, loops=3, noise=0.0)
    lie = graph.lie
    inverse = dense_inverse(graph, truth)
    rows = np.array([0, 5, 23, 5])
    found = marginals(replace(graph, poses=truth), rows, kernel="none", solver=solver)
    np.testing.assert_array_equal(found[0], 0)
    for row, block in zip(rows[1:], found[1:], strict=True):
        at = slice(row * lie.dim, (row + 1) * lie.dim)
        np.testing.assert_allclose(block, inverse[at, at], rtol=1e-6, atol=1e-12)


def test_rows_outside_the_graph_are_refused(ring):
    with pytest.raises(ValueError, match="0 to 59; got 3 to 60"):
        marginals(ring()[0], np.array([3, 60]))
    with pytest.raises(ValueError, match="choose one of"):
        marginals(ring()[0], np.array([3]), kernel="tukey")


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["elimination", "qdldl"])
@pytest.mark.parametrize("group", ["se2", "se3"])
def test_relative_blocks_of_the_inverse_hessian(ring, group, solver):
    graph, _ = ring(group, n=24, loops=3, noise=0.05)
    lie, poses = graph.lie, solve(graph, kernel="none").poses
    inverse, d = dense_inverse(graph, poses), graph.lie.dim
    found = relative_marginals(replace(graph, poses=poses), *PAIRS.T, kernel="none", solver=solver)
    change = jax.jit(
        jax.jacfwd(
            lambda delta, a, b: lie.log(
                lie.compose(
                    lie.inverse(lie.compose(lie.inverse(a), b)),
                    lie.compose(lie.inverse(lie.compose(a, lie.exp(delta[:d]))), lie.compose(b, lie.exp(delta[d:]))),
                )
            )
        )
    )
    for (a, b), block in zip(PAIRS, found, strict=True):
        if a == b:
            np.testing.assert_allclose(block, 0, atol=1e-12)
            continue
        at = np.concatenate([np.arange(d) + a * d, np.arange(d) + b * d])
        by_delta = np.asarray(change(jnp.zeros(2 * d), poses[a], poses[b]))
        np.testing.assert_allclose(block, by_delta @ inverse[np.ix_(at, at)] @ by_delta.T, rtol=1e-6, atol=1e-11)


@pytest.mark.parametrize("group", ["se2", "se3"])
def test_relative_marginals_are_gtsams_whatever_is_fixed(ring, group):
    gtsam = pytest.importorskip("gtsam")
    graph, truth = ring(group, n=24, loops=3, noise=0.0)
    graph, d, planar = replace(graph, poses=truth), graph.lie.dim, group == "se2"
    order = np.arange(3) if planar else np.array([3, 4, 5, 0, 1, 2])

    def pose(p):
        return gtsam.Pose2(*p) if planar else gtsam.Pose3(gtsam.Rot3.Quaternion(*p[:4]), p[4:])

    between = gtsam.BetweenFactorPose2 if planar else gtsam.BetweenFactorPose3
    prior = gtsam.PriorFactorPose2 if planar else gtsam.PriorFactorPose3
    factors, values, poses = gtsam.NonlinearFactorGraph(), gtsam.Values(), [pose(p) for p in np.asarray(truth)]
    for k, p in enumerate(poses):
        values.insert(k, p)
    for i, j, measured, information in zip(graph.i, graph.j, graph.measured, graph.information, strict=True):
        model = gtsam.noiseModel.Gaussian.Information(np.asarray(information)[np.ix_(order, order)])
        factors.add(between(int(i), int(j), pose(np.asarray(measured)), model))
    factors.add(prior(2, poses[2], gtsam.noiseModel.Isotropic.Sigma(d, 0.3)))
    known = gtsam.Marginals(factors, values)
    fixed = np.arange(24) == 11
    found = relative_marginals(graph, *PAIRS.T, kernel="none")
    np.testing.assert_allclose(
        found, relative_marginals(replace(graph, fixed=fixed), *PAIRS.T, kernel="none"), rtol=1e-6, atol=1e-10
    )
    for (a, b), block in zip(PAIRS.tolist(), found, strict=True):
        if a != b:
            joint = known.jointMarginalCovariance(gtsam.KeyVector([a, b]))
            blocks = [[joint.at(p, q) for q in (a, b)] for p in (a, b)]
            to_b = -poses[b].between(poses[a]).AdjointMap()
            by_delta = np.concatenate([to_b, np.eye(d)], 1)
            expected = by_delta @ np.block(blocks) @ by_delta.T
            np.testing.assert_allclose(np.asarray(block)[np.ix_(order, order)], expected, rtol=1e-5, atol=1e-9)


def test_a_chain_adds_up_the_covariances_of_its_steps(ring):
    graph, truth = ring(n=10, loops=0, noise=0.0)
    found = relative_marginals(replace(graph, poses=truth), np.array([4, 4]), np.array([5, 6]), kernel="none")
    first, second = (np.linalg.inv(np.asarray(graph.information)[k]) for k in (4, 5))
    ad = np.asarray(graph.lie.adjoint(graph.lie.inverse(jnp.asarray(graph.measured)[5])))
    np.testing.assert_allclose(found[0], first, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(found[1], ad @ first @ ad.T + second, rtol=1e-8, atol=1e-12)


def test_pairs_outside_the_graph_are_refused_and_none_are_none(ring):
    graph = ring()[0]
    with pytest.raises(ValueError, match="0 to 59; got 3 to 60"):
        relative_marginals(graph, np.array([0, 1]), np.array([3, 60]))
    with pytest.raises(ValueError, match="choose one of"):
        relative_marginals(graph, np.array([3]), np.array([4]), kernel="tukey")
    none = np.zeros(0, int)
    assert relative_marginals(graph, none, none, kernel="none").shape == (0, 3, 3)
