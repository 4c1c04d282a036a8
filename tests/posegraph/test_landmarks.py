"""Landmarks and priors through the same solver, against gtsam and against derivatives by differences."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.posegraph import analyse, marginals, solve
from ebjax.posegraph.factors import edge_costs

WIDTH = jnp.asarray(1.3)
SOLVERS = ["elimination", "qdldl", "supernodal", "cholmod"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("group", "priors"), [("se2", None), ("se2", "position"), ("se3", "pose"), ("se3", "position")]
)
def test_the_optimum_is_gtsams(mapped, in_gtsam, group, priors):
    gtsam = pytest.importorskip("gtsam")
    graph, truth = mapped(group, priors=priors)
    factors, values = in_gtsam(graph, hold=[0] if priors is None else [])
    settings = gtsam.LevenbergMarquardtParams()
    settings.setRelativeErrorTol(1e-14)
    settings.setAbsoluteErrorTol(1e-14)
    best = gtsam.LevenbergMarquardtOptimizer(factors, values, settings).optimize()
    solution = solve(graph, kernel="none", rtol=1e-14)
    assert int(solution.status) == 0
    assert float(solution.initial_cost) == pytest.approx(2 * factors.error(values), rel=1e-9)
    assert float(solution.cost) == pytest.approx(2 * factors.error(best), rel=1e-9)
    place, n = slice(0, 2) if group == "se2" else slice(4, 7), graph.pose_count
    for k, row in enumerate(np.asarray(solution.poses)[: len(truth)]):
        theirs = best.atPoint2(k) if group == "se2" and k >= n else None
        if theirs is None:
            theirs = best.atPoint3(k) if k >= n else getattr(best, "atPose2" if group == "se2" else "atPose3")(k)
            theirs = theirs if k >= n else theirs.translation()
        np.testing.assert_allclose(row[place], theirs, atol=1e-6)
    np.testing.assert_array_equal(solution.poses[n : len(truth), 2 if group == "se2" else 0], float(group == "se3"))


@pytest.mark.parametrize("group", ["se2", "se3"])
def test_marginals_are_gtsams(mapped, in_gtsam, group):
    gtsam = pytest.importorskip("gtsam")
    graph, truth = mapped(group, noise=0.0)
    graph = replace(graph, poses=jnp.asarray(graph.poses).at[: len(truth)].set(truth))
    known = gtsam.Marginals(*in_gtsam(graph))
    space, order = graph.lie.dim // 3 + 1, np.arange(3) if group == "se2" else np.array([3, 4, 5, 0, 1, 2])
    rows = np.arange(len(graph.poses))
    found = np.asarray(marginals(graph, rows, kernel="none"))
    for k in range(graph.pose_count):
        np.testing.assert_allclose(found[k][np.ix_(order, order)], known.marginalCovariance(k), rtol=1e-5, atol=1e-9)
    for k in range(graph.pose_count, len(truth)):
        np.testing.assert_allclose(found[k][:space, :space], known.marginalCovariance(k), rtol=1e-5, atol=1e-9)
        np.testing.assert_array_equal(found[k][space:], 0)
    np.testing.assert_array_equal(found[-1], 0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("solver", "kernel"), [*((solver, "cauchy") for solver in SOLVERS), ("qdldl", "gnc-tls"), ("qdldl", "none")]
)
def test_every_linear_solver_reaches_the_same(mapped, solver, kernel):
    if solver == "cholmod":
        pytest.importorskip("cvxopt")
    graph, _ = mapped("se2", priors="position")
    measured = np.array(graph.measured)
    measured[20, :2] += 3.0  # a landmark mistaken for another
    graph = replace(graph, measured=measured)
    solution = solve(graph, kernel=kernel, solver=solver, rtol=1e-13)
    reference = solve(graph, kernel=kernel, solver="qdldl", rtol=1e-13)
    assert int(solution.status) == 0
    np.testing.assert_allclose(solution.poses, reference.poses, atol=1e-6)
    right = solve(mapped("se2", priors="position")[0], kernel="none", solver="qdldl", rtol=1e-13).poses
    apart = float(jnp.max(jnp.linalg.norm(solution.poses[:, :2] - right[:, :2], axis=1)))
    assert apart > 0.5 if kernel == "none" else apart < 0.1


def central(f, h):
    slope = lambda h: (f(h) - f(-h)) / (2 * h)  # noqa: E731
    return (4 * slope(h) - slope(2 * h)) / 3


@pytest.mark.slow
@pytest.mark.parametrize(("group", "priors"), [("se2", None), ("se3", "position")])
def test_gradients_are_central_differences(mapped, group, priors):
    graph, truth = mapped(group, priors=priors)
    structure, lie, rng = analyse(graph), graph.lie, np.random.default_rng(0)
    place = slice(0, 2) if group == "se2" else slice(4, 7)
    seen = np.asarray(graph.position)[:, None]
    turn, push = jnp.asarray(rng.normal(size=(2, len(seen), lie.dim)))
    root = rng.normal(size=graph.information.shape)
    stretch = jnp.asarray(root + root.swapaxes(1, 2))

    @jax.jit
    def error(by_pose, by_place, by_information):
        measured = lie.compose(jnp.asarray(graph.measured), lie.exp(by_pose * jnp.where(seen, 0, turn)))
        measured = measured.at[:, place].add(by_place * jnp.where(seen, push[:, : lie.dim // 3 + 1], 0))
        at = replace(graph, measured=measured, information=graph.information + by_information * stretch)
        poses = solve(at, structure=structure, rtol=1e-22, max_steps=300).poses
        return jnp.sum((poses[: len(truth), place] - truth[:, place]) ** 2)

    zero = (jnp.zeros(()),) * 3
    slopes = jax.jit(jax.grad(error, argnums=(0, 1, 2)))(*zero)
    for k, h in enumerate((1e-4, 1e-4, 0.3)):
        numeric = central(lambda t, k=k: error(*(t if m == k else 0.0 for m in range(3))), h)
        assert float(slopes[k]) == pytest.approx(float(numeric), rel=1e-6)


def test_positions_cost_what_they_are_off(mapped):
    graph, truth = mapped("se2", priors="position", noise=0.0)
    poses = jnp.asarray(graph.poses).at[: len(truth)].set(truth)
    assert float(jnp.sum(edge_costs(graph, poses, "none", WIDTH))) < 1e-20
    off = edge_costs(graph, poses.at[7, 0].add(0.1), "none", WIDTH)
    assert float(off[-3]) == pytest.approx(200 * 0.1**2)
    turned = edge_costs(graph, poses.at[7, 2].add(0.5), "none", WIDTH)
    assert float(turned[-3]) < 1e-20


def test_graphs_of_poses_alone_keep_their_programs(ring, mapped):
    graph, _ = ring(n=12, loops=2)
    assert analyse(graph).held is None
    assert analyse(graph).free.shape == (12,)
    assert analyse(mapped("se2")[0]).free.shape == (19, 3)
