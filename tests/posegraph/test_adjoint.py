"""Gradients through the solution against central differences (Richardson) in float64."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.posegraph import analyse, solve
from ebjax.posegraph.g2o import read_g2o


def central(f, h):
    slope = lambda h: (f(h) - f(-h)) / (2 * h)  # noqa: E731
    return (4 * slope(h) - slope(2 * h)) / 3


def make(ring, group, kernel, **options):
    graph, truth = ring(group, **options)
    place = slice(0, 2) if group == "se2" else slice(4, 7)

    @jax.jit
    def ate(measured, information, width):
        at = replace(graph, measured=measured, information=information)
        poses = solve(at, kernel=kernel, width=width, rtol=1e-22, max_steps=300).poses
        return jnp.sqrt(jnp.mean(jnp.sum((poses[:, place] - truth[:, place]) ** 2, -1)))

    return graph, ate


@pytest.mark.parametrize(("group", "kernel"), [("se2", "none"), ("se2", "cauchy"), ("se3", "none"), ("se3", "cauchy")])
def test_gradient_of_the_ate_is_its_central_difference(ring, group, kernel):
    graph, ate = make(ring, group, kernel, n=100, loops=6, false_loops=1)
    m, o, w = graph.measured, graph.information, jnp.asarray(1.0)
    by_measured, by_information, by_width = jax.grad(ate, argnums=(0, 1, 2))(m, o, w)
    rng, lie = np.random.default_rng(0), graph.lie
    for edge in (len(graph.i) - 2, 20):
        for direction in np.eye(lie.dim)[:: 1 if group == "se2" else 2]:
            tangent = jnp.zeros((len(graph.i), lie.dim)).at[edge].set(jnp.asarray(direction))
            moved = lambda t, tangent=tangent: lie.compose(m, lie.exp(t * tangent))  # noqa: E731
            analytic = jnp.sum(by_measured * jax.jvp(moved, (0.0,), (1.0,))[1])
            numeric = central(lambda t, moved=moved: ate(moved(t), o, w), 1e-4)
            assert float(analytic) == pytest.approx(float(numeric), rel=1e-6)
    change = jnp.asarray(rng.normal(size=o.shape))
    change = change + change.swapaxes(1, 2)
    numeric = central(lambda t: ate(m, o + t * change, w), 0.3)
    assert float(jnp.sum(by_information * change)) == pytest.approx(float(numeric), rel=1e-6)
    if kernel == "cauchy":
        assert float(by_width) == pytest.approx(float(central(lambda t: ate(m, o, w + t), 1e-3)), rel=1e-6)


def test_forward_mode_agrees_with_reverse_mode(ring):
    graph, ate = make(ring, "se2", "cauchy", n=30, loops=3)
    arguments = (graph.measured, graph.information, jnp.asarray(1.0))
    rng = np.random.default_rng(0)
    tangents = tuple(jnp.asarray(rng.normal(size=x.shape)) for x in arguments)
    gradient = jax.grad(ate, argnums=(0, 1, 2))(*arguments)
    backward = sum(jnp.sum(g * t) for g, t in zip(gradient, tangents, strict=True))
    assert float(jax.jvp(ate, arguments, tangents)[1]) == pytest.approx(float(backward), rel=1e-9)


def test_gradient_of_the_cost_and_of_a_fixed_pose(ring):
    graph, _ = ring(n=20, loops=3, false_loops=1)

    def final(poses, measured):
        solution = solve(replace(graph, poses=poses, measured=measured), rtol=1e-22)
        return solution.cost, jnp.sum(solution.poses[-1])

    m, direction = graph.measured, jnp.zeros_like(graph.measured).at[-1, 0].set(1.0)
    gradient = jax.grad(lambda m: final(graph.poses, m)[0])(m)
    numeric = central(lambda t: final(graph.poses, m + t * direction)[0], 1e-4)
    assert float(gradient[-1, 0]) == pytest.approx(float(numeric), rel=1e-6)
    by_pose = jax.grad(lambda p: final(p, m)[1])(graph.poses)
    numeric = central(lambda t: final(graph.poses.at[0, 2].add(t), m)[1], 1e-4)
    assert float(by_pose[0, 2]) == pytest.approx(float(numeric), rel=1e-6)
    assert abs(by_pose[1:]).max() == 0


@pytest.mark.parametrize("kernel", ["none", "cauchy"])
def test_gradient_on_a_real_run(data, kernel):
    graph, _ = read_g2o(data("d5_pose_graph/lessNoise.g2o"))
    structure, loop = analyse(graph), int(np.argmax(np.abs(np.asarray(graph.i) - np.asarray(graph.j)) > 1))

    @jax.jit
    def end(t):
        measured = jnp.asarray(graph.measured).at[loop].add(t)
        poses = solve(replace(graph, measured=measured), kernel=kernel, structure=structure, rtol=1e-22).poses
        return jnp.mean(jnp.sum((poses[:, :2] - graph.poses[:, :2]) ** 2, -1))

    gradient = jax.jit(jax.grad(end))(jnp.zeros(3))
    for analytic, axis in zip(gradient, np.eye(3), strict=True):
        numeric = central(lambda h, axis=axis: float(end(jnp.asarray(h * axis))), 1e-4)
        assert float(analytic) == pytest.approx(numeric, rel=1e-4)
