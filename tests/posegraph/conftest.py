from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.geometry.lie import GROUPS
from ebjax.posegraph import add_priors, make_graph


@cache
def ring(group="se2", n=60, loops=6, false_loops=0, noise=0.02, seed=0, dtype=jnp.float64):
    """A path that goes round twice, odometry and loops between the rounds, poses from odometry; and the truth."""
    rng, g = np.random.default_rng(seed), GROUPS[group]
    step = np.zeros((n - 1, g.dim))
    step[:, 0], step[:, -1] = 0.5, 4 * np.pi / n
    if group == "se3":
        step[:, 3:5] = 0.05 * rng.normal(size=(n - 1, 2))
    first = rng.integers(0, n // 2, loops)
    second = first + rng.integers(n // 3, n // 2 - 1, loops)
    i, j = np.concatenate([np.arange(n - 1), first]), np.concatenate([np.arange(1, n), second])
    error = rng.normal(size=(len(i), g.dim)) * noise
    if false_loops:
        error[-false_loops:] += rng.normal(size=(false_loops, g.dim))
    truth, measured, poses = driven(group, step, i, j, error)
    root = rng.normal(size=(len(i), g.dim, g.dim))
    information = 500 * np.eye(g.dim)[None] + 20 * (root @ root.swapaxes(1, 2))
    arrays = (jnp.asarray(x, dtype) for x in (poses, measured, information))
    poses, measured, information = arrays
    return make_graph(poses, i, j, measured, information), truth.astype(dtype)


@partial(jax.jit, static_argnames="group")
def driven(group, step, i, j, error):
    """The true path, what its edges measure, and the path by odometry."""
    g = GROUPS[group]
    truth = compose_all(g, jnp.asarray(g.identity), g.exp(step))
    measured = g.compose(g.compose(g.inverse(truth[i]), truth[j]), g.exp(error))
    return truth, measured, compose_all(g, truth[0], measured[: len(step)])


def compose_all(g, start, steps):
    _, poses = jax.lax.scan(lambda pose, step: (g.compose(pose, step),) * 2, start, steps)
    return jnp.concatenate([start[None], poses])


def mapped(group="se2", n=14, points=4, priors="pose", noise=0.03, seed=0):
    """A ring with landmarks seen from several poses; priors on a pose, on positions, or none. And the truth."""
    graph, truth = ring(group, n=n, loops=2, noise=noise, seed=seed)
    rng, g, space = np.random.default_rng(seed + 1), graph.lie, graph.lie.dim // 3 + 1
    truth, place = np.asarray(truth), slice(0, 2) if group == "se2" else slice(4, 7)
    seen = truth[rng.integers(0, n, points)][:, place] + rng.normal(size=(points, space))
    rows = np.tile(g.identity, (points, 1))
    rows[:, place] = seen
    truth = np.concatenate([truth, rows])
    i, j = np.repeat(rng.integers(0, n, 3 * points), 1), n + np.arange(3 * points) % points
    relative = np.asarray(jax.jit(lambda a, b: g.compose(g.inverse(a), b))(truth[i], truth[j]))
    measured = np.tile(g.identity, (len(i), 1))
    measured[:, place] = relative[:, place] + noise * rng.normal(size=(len(i), space))
    information = np.zeros((len(i), g.dim, g.dim))
    root = rng.normal(size=(len(i), space, space))
    information[:, :space, :space] = 300 * np.eye(space) + 50 * root @ root.swapaxes(1, 2)
    start = rows.copy()
    start[:, place] += 0.2 * rng.normal(size=seen.shape)
    edges = len(graph.i)
    graph = make_graph(
        np.concatenate([graph.poses, start]),
        np.concatenate([graph.i, i]),
        np.concatenate([graph.j, j]),
        np.concatenate([graph.measured, measured]),
        np.concatenate([graph.information, information]),
        position=np.arange(edges + len(i)) >= edges,
        landmark=np.arange(n + points) >= n,
    )
    if priors is None:
        return graph, truth
    tied = np.array([2, 7, n - 1, n]) if priors == "position" else np.array([3, n - 2, n + 1])
    place_only = np.ones(4, bool) if priors == "position" else np.array([False, True, True])
    said = truth[tied].copy()
    said[:, place] += noise * rng.normal(size=(len(tied), space))
    weight = np.tile(200.0 * np.eye(g.dim), (len(tied), 1, 1))
    weight[place_only, space:] = 0
    return add_priors(graph, tied, said, weight, position=place_only, robust=np.ones(len(tied), bool)), truth


def in_gtsam(graph, *, hold=()):
    """The same graph in gtsam, every factor built by hand: factors and starting values."""
    gtsam = pytest.importorskip("gtsam")

    planar, space = graph.group == "se2", graph.lie.dim // 3 + 1
    order = np.arange(3) if planar else np.array([3, 4, 5, 0, 1, 2])
    place = slice(0, 2) if planar else slice(4, 7)
    model, symbols = gtsam.noiseModel.Gaussian.Information, ("Pose2", "Point2") if planar else ("Pose3", "Point3")
    make = lambda kind, of: getattr(gtsam, f"{kind}Factor{symbols[of]}")  # noqa: E731
    pose = lambda p: gtsam.Pose2(*p) if planar else gtsam.Pose3(gtsam.Rot3.Quaternion(*p[:4]), p[4:])  # noqa: E731
    poses, world = np.asarray(graph.poses, float), len(graph.poses) - 1 if graph.world else -1
    point = np.zeros(len(poses), bool) if graph.landmark is None else np.asarray(graph.landmark)
    position = np.zeros(len(graph.i), bool) if graph.position is None else np.asarray(graph.position)
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, p in enumerate(poses):
        if k != world:
            values.insert(k, p[place] if point[k] else pose(p))
    edges = (np.asarray(x) for x in (graph.i, graph.j, graph.measured, graph.information))
    for k, (i, j, z, omega) in enumerate(zip(*edges, strict=True)):
        i, j = int(i), int(j)
        noise = model(omega[:space, :space]) if position[k] else model(omega[np.ix_(order, order)])
        if i == world and not position[k]:
            factors.add(make("Prior", 0)(j, pose(z), noise))
        elif i == world and point[j]:
            factors.add(make("Prior", 1)(j, z[place], noise))
        elif i == world:
            factors.add(getattr(gtsam, f"PoseTranslationPrior{space}D")(j, pose(z), noise))
        elif position[k]:
            factors.add(gtsam.CustomFactor(noise, [i, j], sight(symbols, z[place])))
        else:
            factors.add(make("Between", 0)(i, j, pose(z), noise))
    for k in hold:
        factors.add(getattr(gtsam, f"NonlinearEquality{symbols[0]}")(k, pose(poses[k])))
    return factors, values


def sight(symbols, z):
    """The error of a point seen from a pose."""

    def error(factor, values, jacobians):
        i, j = factor.keys()
        pose, point = getattr(values, f"at{symbols[0]}")(i), getattr(values, f"at{symbols[1]}")(j)
        by_pose = np.zeros((len(z), 3 if len(z) == 2 else 6), order="F")
        by_point = np.zeros((len(z), len(z)), order="F")
        seen = pose.transformTo(point, by_pose, by_point)
        if jacobians is not None:
            jacobians[0], jacobians[1] = by_pose, by_point
        return seen - z

    return error


@pytest.fixture(name="mapped")
def _mapped():
    return mapped


@pytest.fixture(name="in_gtsam")
def _in_gtsam():
    pytest.importorskip("gtsam")
    return in_gtsam


def only(graph, keep):
    """The graph with some of its edges."""
    names = ("i", "j", "measured", "information", "robust")
    return replace(graph, **{name: np.asarray(getattr(graph, name))[keep] for name in names})


@pytest.fixture(name="only")
def _only():
    return only


@pytest.fixture(name="ring", scope="session")
def _ring():
    return ring
