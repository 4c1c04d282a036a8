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

    def ate(measured, information, width):
        at = replace(graph, measured=measured, information=information)
        poses = solve(at, kernel=kernel, width=width, rtol=1e-22, max_steps=300).poses
        return jnp.sqrt(jnp.mean(jnp.sum((poses[:, place] - truth[:, place]) ** 2, -1)))

    return graph, ate


@pytest.mark.slow
@pytest.mark.parametrize(("group", "kernel"), [("se2", "none"), ("se2", "cauchy"), ("se3", "none"), ("se3", "cauchy")])
def test_gradient_of_the_ate_is_its_central_difference(ring, group, kernel):
    graph, ate = make(ring, group, kernel, n=100, loops=6, false_loops=1)
    descend = jax.jit(jax.value_and_grad(ate, argnums=(0, 1, 2)))  # one program for values and gradients
    m, o, w = np.asarray(graph.measured), np.asarray(graph.information), 1.0
    by_measured, by_information, by_width = map(np.asarray, descend(m, o, w)[1])
    rng, lie = np.random.default_rng(0), graph.lie

    def value(measured, information, width):
        return float(descend(measured, information, width)[0])

    @jax.jit
    def moved(t, tangent):
        return jax.jvp(lambda t: lie.compose(jnp.asarray(m), lie.exp(t * tangent)), (t,), (1.0,))

    for edge in (len(graph.i) - 2, 20):
        for direction in np.eye(lie.dim)[:: 1 if group == "se2" else 2]:
            tangent = np.zeros((len(graph.i), lie.dim))
            tangent[edge] = direction
            analytic = np.sum(by_measured * np.asarray(moved(0.0, tangent)[1]))
            numeric = central(lambda t, tangent=tangent: value(moved(t, tangent)[0], o, w), 1e-4)
            assert analytic == pytest.approx(numeric, rel=1e-6)
    change = rng.normal(size=o.shape)
    change = change + change.swapaxes(1, 2)
    numeric = central(lambda t: value(m, o + t * change, w), 0.3)
    assert np.sum(by_information * change) == pytest.approx(numeric, rel=1e-6)
    if kernel == "cauchy":
        assert float(by_width) == pytest.approx(central(lambda t: value(m, o, w + t), 1e-3), rel=1e-6)


@pytest.mark.slow
def test_forward_mode_agrees_with_reverse_mode(ring):
    graph, ate = make(ring, "se2", "cauchy", n=30, loops=3)
    arguments = tuple(map(np.asarray, (graph.measured, graph.information, 1.0)))
    rng = np.random.default_rng(0)
    tangents = tuple(np.asarray(rng.normal(size=x.shape)) for x in arguments)
    gradient = jax.jit(jax.grad(ate, argnums=(0, 1, 2)))(*arguments)
    backward = sum(np.sum(g * t) for g, t in zip(gradient, tangents, strict=True))
    forward = jax.jit(lambda at, along: jax.jvp(ate, at, along)[1])(arguments, tangents)
    assert float(forward) == pytest.approx(float(backward), rel=1e-9)


@pytest.mark.slow
def test_gradient_of_the_cost_and_of_a_fixed_pose(ring):
    graph, _ = ring(n=20, loops=3, false_loops=1)

    def final(poses, measured):
        solution = solve(replace(graph, poses=poses, measured=measured), rtol=1e-22)
        return solution.cost, jnp.sum(solution.poses[-1])

    poses, m = np.asarray(graph.poses), np.asarray(graph.measured)
    step, turn = np.zeros_like(m), np.zeros_like(poses)
    step[-1, 0] = turn[0, 2] = 1.0
    cost = jax.jit(jax.value_and_grad(lambda m: final(poses, m)[0]))
    gradient = cost(m)[1]
    numeric = central(lambda t: float(cost(m + t * step)[0]), 1e-4)
    assert float(gradient[-1, 0]) == pytest.approx(numeric, rel=1e-6)
    end = jax.jit(jax.value_and_grad(lambda p: final(p, m)[1]))
    by_pose = np.asarray(end(poses)[1])
    numeric = central(lambda t: float(end(poses + t * turn)[0]), 1e-4)
    assert float(by_pose[0, 2]) == pytest.approx(numeric, rel=1e-6)
    assert abs(by_pose[1:]).max() == 0


@pytest.mark.slow
@pytest.mark.parametrize("kernel", ["none", "cauchy"])
def test_gradient_on_a_real_run(data, kernel):
    graph, _ = read_g2o(data("d5_pose_graph/lessNoise.g2o"))
    structure, loop = analyse(graph), int(np.argmax(np.abs(np.asarray(graph.i) - np.asarray(graph.j)) > 1))

    @jax.jit
    @jax.value_and_grad
    def end(t):
        measured = jnp.asarray(graph.measured).at[loop].add(t)
        poses = solve(replace(graph, measured=measured), kernel=kernel, structure=structure, rtol=1e-22).poses
        return jnp.mean(jnp.sum((poses[:, :2] - graph.poses[:, :2]) ** 2, -1))

    for analytic, axis in zip(end(np.zeros(3))[1], np.eye(3), strict=True):
        numeric = central(lambda h, axis=axis: float(end(h * axis)[0]), 1e-4)
        assert float(analytic) == pytest.approx(numeric, rel=1e-4)
