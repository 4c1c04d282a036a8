"""VLAD and k-means against plain loops, and VLAD's gradient against central differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from scipy.cluster.vq import kmeans2

from ebjax.models.layers import normalise
from ebjax.models.netvlad import Aggregation
from ebjax.places.vlad import SECOND_SHARE, Vocabulary, kmeans, learn_vocabulary, netvlad, shares
from ebjax.places.vlad import vlad as by_words


@jax.jit
def vlad(values, mask, centres, alpha):
    return by_words(values, mask, Vocabulary(centres, jnp.asarray(alpha, values.dtype)))


RNG = np.random.default_rng(2)
VALUES, CENTRES = RNG.standard_normal((20, 5)), RNG.standard_normal((4, 5))
MASK = (RNG.random(20) < 0.7).astype(float)


def by_loop(values, mask, centres, alpha):
    residual = np.zeros_like(centres)
    for value, counts in zip(values, mask, strict=True):
        closeness = np.exp(-alpha * np.sum((value - centres) ** 2, 1))
        for k, centre in enumerate(centres):
            residual[k] += counts * closeness[k] / closeness.sum() * (value - centre)
    residual /= np.linalg.norm(residual, axis=1, keepdims=True)
    return residual.reshape(-1) / np.linalg.norm(residual)


@pytest.mark.parametrize("alpha", [0.5, 30.0])
def test_vlad_is_the_paper_s_sum(alpha):
    ours = vlad(jnp.asarray(VALUES), jnp.asarray(MASK), jnp.asarray(CENTRES), alpha)
    np.testing.assert_allclose(ours, by_loop(VALUES, MASK, CENTRES, alpha), atol=1e-9)


def test_large_alpha_assigns_hard():
    ours = np.asarray(vlad(jnp.asarray(VALUES), jnp.asarray(MASK), jnp.asarray(CENTRES), 1e4)).reshape(4, 5)
    nearest = np.argmin(np.linalg.norm(VALUES[:, None] - CENTRES[None], axis=-1), axis=1)
    for k in range(4):
        residual = ((VALUES - CENTRES[k]) * (MASK * (nearest == k))[:, None]).sum(0)
        np.testing.assert_allclose(ours[k] * 2, residual / np.linalg.norm(residual), atol=1e-6)


def test_gradient_of_vlad_is_that_of_central_differences():
    direction = jnp.asarray(RNG.standard_normal(20))

    @jax.jit
    def score(values, centres):
        return vlad(values, jnp.asarray(MASK), centres, 1.5) @ direction

    arguments = jnp.asarray(VALUES), jnp.asarray(CENTRES)
    for which, gradient in enumerate(jax.jit(jax.grad(score, (0, 1)))(*arguments)):
        step = jnp.asarray(RNG.standard_normal(gradient.shape))
        ends = [score(*(a + s * 1e-6 * step if k == which else a for k, a in enumerate(arguments))) for s in (1, -1)]
        np.testing.assert_allclose(jnp.sum(gradient * step), (ends[0] - ends[1]) / 2e-6, rtol=1e-6)


def test_a_view_without_cells_is_zero_with_a_finite_gradient():
    empty = jnp.zeros(20)
    np.testing.assert_array_equal(vlad(jnp.asarray(VALUES), empty, jnp.asarray(CENTRES), 30.0), 0)
    gradient = jax.jit(jax.grad(lambda values: vlad(values, empty, jnp.asarray(CENTRES), 30.0).sum()))(
        jnp.asarray(VALUES)
    )
    assert np.isfinite(gradient).all()


def test_kmeans_are_lloyd_s_iterations():
    points, key = RNG.standard_normal((200, 3)), jax.random.key(4)
    first = points[np.asarray(jax.random.choice(key, 200, (6,), replace=False))]
    expected, _ = kmeans2(points, first, iter=15, minit="matrix")
    np.testing.assert_allclose(kmeans(jnp.asarray(points), clusters=6, key=key), expected, atol=1e-9)


def test_kmeans_finds_separate_clusters_and_survives_too_few_points():
    corners = np.array([[0, 0], [9, 0], [0, 9], [9, 9]], np.float32)
    points = jnp.asarray(np.repeat(corners, 50, 0) + RNG.normal(0, 0.1, (200, 2)).astype(np.float32))
    best = min(
        (kmeans(points, clusters=4, key=jax.random.key(seed)) for seed in range(8)),
        key=lambda centres: float(jnp.min(jnp.sum((points[:, None] - centres[None]) ** 2, -1), 1).sum()),
    )
    np.testing.assert_allclose(np.asarray(best)[np.lexsort(np.asarray(best).round().T)], corners, atol=0.1)
    assert best.dtype == jnp.float32
    assert np.isfinite(kmeans(points[:2], clusters=4, key=jax.random.key(0))).all()


def test_the_second_nearest_word_gets_its_share_whatever_the_scale():
    points = RNG.standard_normal((500, 4))
    for scale in (1.0, 0.01):
        words = learn_vocabulary(jnp.asarray(scale * points), clusters=6, key=jax.random.key(0))
        share = np.sort(np.asarray(jax.jit(shares)(jnp.asarray(scale * points), jnp.ones(500), words)), 1)
        np.testing.assert_allclose(np.exp(np.mean(np.log(share[:, -2] / share[:, -1]))), SECOND_SHARE, rtol=1e-6)
    alone = learn_vocabulary(jnp.ones((3, 4)), clusters=1, key=jax.random.key(0))
    assert np.isfinite(alone.alpha)


def test_an_assignment_of_its_own_is_the_published_layer():
    layer = Aggregation(4, 5, convention="nanne", bias=True, rngs=nnx.Rngs(0))
    values = normalise(jnp.asarray(VALUES))
    names = ("centroids", "assignment", "bias")
    arrays = (jnp.asarray(getattr(layer, name)[...], jnp.float64) for name in names)
    ours = netvlad(values, jnp.ones(len(VALUES)), *arrays)
    np.testing.assert_allclose(ours, layer(values[None, None])[0], atol=1e-5)
