"""Soft matches against hard ones and against the motion that made them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.features.soft_match import dual_softmax, soft_measure
from ebjax.geometry.rigid import kabsch

ANGLE, SHIFT = 2.9, np.array([1.7, -0.3])


def make(noise=0.0, wrong=0, seed=0):
    """Points with descriptors of their own, seen from two bases; the last `wrong` rows of i show other things."""
    rng = np.random.default_rng(seed)
    unit = lambda x: x / np.linalg.norm(x, axis=1, keepdims=True)  # noqa: E731
    points_j, descriptors = rng.uniform(-0.6, 0.6, (60, 2)), unit(rng.normal(size=(60, 16)))
    c, s = np.cos(ANGLE), np.sin(ANGLE)
    points_i = points_j @ np.array([[c, -s], [s, c]]).T + SHIFT
    order = rng.permutation(60)
    seen = unit(descriptors[order] + noise * rng.normal(size=(60, 16)))
    points_i = points_i[order]
    points_i[60 - wrong :] = rng.uniform(1, 3, (wrong, 2))
    return tuple(map(jnp.asarray, (points_i, points_j, seen, descriptors))), order


@pytest.mark.parametrize(("noise", "wrong"), [(0.0, 0), (0.1, 0), (0.05, 20)])
def test_finds_the_motion(noise, wrong):
    (points_i, points_j, a, b), order = make(noise, wrong)
    matches = dual_softmax(a, b, jnp.ones(60), jnp.ones(60), 0.03)
    assert (np.asarray(matches).argmax(1) == order).mean() > 0.9
    found = soft_measure(points_i, points_j, matches)
    np.testing.assert_allclose(found.i_from_j, [*SHIFT, ANGLE], atol=1e-3 if wrong == 0 else 5e-3)
    assert np.linalg.eigvalsh(found.covariance).min() > 0


def test_what_has_no_weight_does_not_count():
    (_, _, a, b), _ = make(0.1)
    mask = jnp.arange(60) % 3 > 0
    matches = dual_softmax(a, b, mask.astype(float), mask.astype(float), 0.05)
    kept = dual_softmax(a[mask], b[mask], jnp.ones(40), jnp.ones(40), 0.05)
    np.testing.assert_allclose(matches[mask][:, mask], kept, atol=1e-12)
    assert float(jnp.sum(matches)) == pytest.approx(float(jnp.sum(kept)))


def test_mean_partners_are_all_pairs():
    (points_i, points_j, a, b), _ = make(0.3)
    matches = dual_softmax(a, b, jnp.ones(60), jnp.ones(60), 0.3)
    i, j = np.divmod(np.arange(3600), 60)
    every = kabsch(points_j[j], points_i[i], matches.reshape(-1))
    share = matches.sum(1)
    mean = kabsch(matches @ points_j / share[:, None], points_i, share)
    for one, other in zip(every, mean, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)


@pytest.mark.slow
def test_derivatives():
    (points_i, points_j, a, b), _ = make(0.2, 10)

    @jax.jit
    def value(points_j, b):
        found = soft_measure(points_i, points_j, dual_softmax(a, b, jnp.ones(60), jnp.ones(60), 0.1))
        return jnp.sum(found.i_from_j * jnp.array([1.0, 2.0, 3.0])) + jnp.trace(found.covariance)

    rng = np.random.default_rng(3)
    for k, at in enumerate((points_j, b)):
        direction = jnp.asarray(rng.normal(size=at.shape))
        moved = [[points_j, b] for _ in range(2)]
        moved[0][k], moved[1][k] = at + 1e-6 * direction, at - 1e-6 * direction
        numeric = (value(*moved[0]) - value(*moved[1])) / 2e-6
        slope = jax.grad(value, argnums=k)(points_j, b)
        assert float(jnp.sum(slope * direction)) == pytest.approx(float(numeric), rel=1e-6)
