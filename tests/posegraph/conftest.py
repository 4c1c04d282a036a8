from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.geometry.lie import GROUPS
from ebjax.posegraph import make_graph


def ring(group="se2", n=60, loops=6, false_loops=0, noise=0.02, seed=0, dtype=jnp.float64):
    """A path that goes round twice, odometry and loops between the rounds, poses from odometry; and the truth."""
    rng, g = np.random.default_rng(seed), GROUPS[group]
    step = np.zeros((n - 1, g.dim))
    step[:, 0], step[:, -1] = 0.5, 4 * np.pi / n
    if group == "se3":
        step[:, 3:5] = 0.05 * rng.normal(size=(n - 1, 2))
    truth = compose_all(g, jnp.asarray(g.identity), jax.jit(g.exp)(jnp.asarray(step)))
    first = rng.integers(0, n // 2, loops)
    second = first + rng.integers(n // 3, n // 2 - 1, loops)
    i, j = np.concatenate([np.arange(n - 1), first]), np.concatenate([np.arange(1, n), second])
    error = rng.normal(size=(len(i), g.dim)) * noise
    if false_loops:
        error[-false_loops:] += rng.normal(size=(false_loops, g.dim))
    measured = jax.jit(lambda a, b, e: g.compose(g.compose(g.inverse(a), b), g.exp(e)))(truth[i], truth[j], error)
    root = rng.normal(size=(len(i), g.dim, g.dim))
    information = 500 * np.eye(g.dim)[None] + 20 * (root @ root.swapaxes(1, 2))
    poses = compose_all(g, truth[0], measured[: n - 1])
    arrays = (jnp.asarray(x, dtype) for x in (poses, measured, information))
    poses, measured, information = arrays
    return make_graph(poses, i, j, measured, information), truth.astype(dtype)


def compose_all(g, start, steps):
    _, poses = jax.lax.scan(lambda pose, step: (g.compose(pose, step),) * 2, start, steps)
    return jnp.concatenate([start[None], poses])


def only(graph, keep):
    """The graph with some of its edges."""
    names = ("i", "j", "measured", "information", "robust")
    return replace(graph, **{name: np.asarray(getattr(graph, name))[keep] for name in names})


@pytest.fixture(name="only")
def _only():
    return only


@pytest.fixture(name="ring")
def _ring():
    return ring
