"""Components against an ordinary eigenproblem; k-means that keeps its mirror images."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.places.learn_words import closed_kmeans, components, learn_words

D = 12


def reverse(values):
    """Stands for R_pi: an involution that mixes channels."""
    return values[..., ::-1]


def drawn(count=400, seed=0):
    rng = np.random.default_rng(seed)
    return jnp.asarray(rng.standard_normal((count, D)) @ rng.standard_normal((D, D)))


@pytest.mark.parametrize("seed", [0, 1])
def test_components_are_those_of_points_and_mirror_images(seed):
    rows = drawn(seed=seed)
    basis, parity = map(np.asarray, components(rows, reverse))
    both = np.concatenate([rows, reverse(rows)])
    covariance = both.T @ both / len(both)
    assert basis.shape == (D, D)
    np.testing.assert_allclose(basis.T @ basis, np.eye(D), atol=1e-9)
    np.testing.assert_allclose(basis[::-1], basis * parity, atol=1e-12)
    expected = np.linalg.eigvalsh(covariance)[::-1]
    np.testing.assert_allclose(basis.T @ covariance @ basis, np.diag(expected), atol=1e-8 * expected[0])


@pytest.mark.parametrize("count", [3, 8])
def test_centres_are_the_means_of_their_points_and_of_mirror_images_turned_back(count):
    parity = np.where(np.arange(D) < D // 2, 1.0, -1.0)
    rng = np.random.default_rng(1)
    blobs = rng.standard_normal((count, D)) * 5
    labels = rng.integers(0, count, 600)
    signs = rng.choice([True, False], 600)
    points = blobs[labels] + 0.05 * rng.standard_normal((600, D))
    points = np.where(signs[:, None], points * parity, points)
    centres, alpha = closed_kmeans(jnp.asarray(points), jnp.asarray(parity), count, key=jax.random.key(0))
    centres = np.asarray(centres)
    both = np.concatenate([centres, centres * parity])
    nearest = ((points[:, None] - both[None]) ** 2).sum(-1).argmin(1)
    for k in range(count):
        mine = np.concatenate([points[nearest == k], points[nearest == k + count] * parity])
        if len(mine):
            np.testing.assert_allclose(centres[k], mine.mean(0), atol=1e-9)
    assert float(alpha) > 0


def test_the_mean_is_the_same_under_turning():
    made = learn_words(drawn() + 3.0, reverse, key=jax.random.key(0))
    np.testing.assert_allclose(made["mean"], made["mean"][::-1], atol=1e-9)
    assert set(made) == {"mean", "basis", "parity", "words", "alpha"}
