import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

from ebjax.models import netvlad
from ebjax.models.catalogue import recognise, restore
from ebjax.models.layers import normalise
from ebjax.models.netvlad import Aggregation, Whitening, initial_vocabulary, learn_whitening
from ebjax.models.seeded import seeded_state
from ebjax.models.weights import load_into


@pytest.fixture
def descriptors():
    return normalise(jnp.asarray(np.random.default_rng(0).normal(size=(40, 6))))


@pytest.fixture(scope="module")
def nanne():
    return seeded_state("netvlad_wpca", 3)


def by_hand(x, weights, bias, centroids):
    """Equations 3 and 4, one descriptor and one cluster at a time."""
    total = np.zeros_like(centroids)
    for descriptor in x:
        share = np.exp(descriptor @ weights + bias)
        share /= share.sum()
        for k, centre in enumerate(centroids):
            total[k] += share[k] * (descriptor - centre)
    rows = total / np.linalg.norm(total, axis=1, keepdims=True)
    return rows / np.linalg.norm(rows)


@pytest.mark.parametrize("bias", [False, True])
def test_is_the_papers_sum(bias):
    rng = np.random.default_rng(1)
    x, weights, centroids, b = (rng.normal(size=s) for s in ((12, 6), (6, 4), (4, 6), 4))
    vectors = {}
    for convention in ("matlab", "nanne"):
        layer = Aggregation(4, 6, convention=convention, bias=bias, rngs=nnx.Rngs(0))
        load_into(layer, {"assignment": weights, "centroids": centroids} | ({"bias": b} if bias else {}))
        vectors[convention] = layer(jnp.asarray(3 * x, jnp.float32).reshape(1, 3, 4, 6))[0]
    want = by_hand(x / np.linalg.norm(x, axis=1, keepdims=True), weights, b * bias, centroids)
    np.testing.assert_allclose(vectors["nanne"], want.reshape(-1), atol=1e-6)
    np.testing.assert_allclose(vectors["matlab"], want.T.reshape(-1), atol=1e-6)


@pytest.mark.slow
def test_gradients_match_differences_and_are_finite_on_a_flat_map():
    layer = jax.tree.map(lambda leaf: leaf.astype(jnp.float64), Aggregation(4, 6, bias=True, rngs=nnx.Rngs(2)))
    graph, state = nnx.split(layer)
    x = jnp.asarray(np.random.default_rng(3).normal(size=(2, 3, 4, 6)))
    target = jnp.asarray(np.random.default_rng(4).normal(size=(2, 24)))
    loss = lambda state, x: jnp.sum(target * nnx.merge(graph, state)(x))  # noqa: E731
    gradient = jax.grad(loss, (0, 1))(state, x)
    direction = jax.tree.map(lambda leaf: jnp.sin(1 + jnp.arange(leaf.size * 1.0)).reshape(leaf.shape), (state, x))
    ends = [loss(*jax.tree.map(lambda p, d, s=s: p + s * 1e-6 * d, (state, x), direction)) for s in (1, -1)]
    slope = sum(jnp.vdot(a, b) for a, b in zip(*map(jax.tree.leaves, (gradient, direction)), strict=True))
    np.testing.assert_allclose((ends[0] - ends[1]) / 2e-6, slope, rtol=1e-6)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(jax.grad(loss, (0, 1))(state, 0 * x)))


def test_vocabulary_from_centres_gives_the_second_a_hundredth(descriptors):
    centroids = jnp.asarray(np.random.default_rng(5).normal(size=(5, 6))) * jnp.array([0.5, 1, 1, 2, 3])[:, None]
    layer = Aggregation(5, 6, rngs=nnx.Rngs(0))
    load_into(layer, initial_vocabulary(centroids, descriptors))
    share = jnp.sort(layer.soft_assignment(descriptors[None])[0])
    np.testing.assert_allclose(jnp.log(share[:, -2] / share[:, -1]).mean(), np.log(0.01), rtol=1e-4)
    with_bias = Aggregation(5, 6, bias=True, rngs=nnx.Rngs(0))
    vocabulary = initial_vocabulary(centroids, descriptors, bias=True)
    load_into(with_bias, vocabulary)
    squared = jnp.sum((descriptors[:, None] - centroids[None]) ** 2, -1)
    alpha = -vocabulary["bias"][0] / jnp.sum(centroids[0] ** 2)
    share = with_bias.soft_assignment(descriptors[None])[0]
    np.testing.assert_allclose(share, jax.nn.softmax(-alpha * squared), atol=1e-4)
    nearest = jnp.sort(squared)
    np.testing.assert_allclose(alpha * (nearest[:, 1] - nearest[:, 0]).mean(), -np.log(0.01), rtol=1e-6)


@pytest.mark.parametrize("count", [50, 9])
def test_whitening_is_pca(count):
    rng = np.random.default_rng(6)
    vectors = rng.normal(size=(count, 20)) * np.linspace(1, 3, 20) + 5
    layer = Whitening(20, 4, rngs=nnx.Rngs(0))
    learned = learn_whitening(jnp.asarray(vectors), 4)
    load_into(layer, learned)
    projected = np.asarray(layer.project(jnp.asarray(vectors, jnp.float32)))
    np.testing.assert_allclose(projected.mean(0), 0, atol=1e-4)
    np.testing.assert_allclose(np.cov(projected.T), np.eye(4), atol=1e-3)
    values, directions = np.linalg.eigh(np.cov(vectors.T))
    want = directions[:, ::-1][:, :4] / np.sqrt(values[::-1][:4])
    np.testing.assert_allclose(np.abs(learned["kernel"]), np.abs(want), atol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(layer(jnp.asarray(vectors, jnp.float32)), axis=1), 1, rtol=1e-5)


def test_whitening_needs_enough_vectors_and_survives_flat_directions():
    with pytest.raises(ValueError, match="5 vectors of 20 give at most 4 components"):
        learn_whitening(jnp.ones((5, 20)), 5)
    flat = jnp.concatenate([jnp.asarray(np.random.default_rng(0).normal(size=(9, 2))), jnp.zeros((9, 3))], 1)
    learned = learn_whitening(flat, 4)
    assert all(np.isfinite(array).all() for array in learned.values())


def test_several_gpus_bias_and_whitening_of_nanne(nanne):
    parallel = {
        key.replace("encoder.", "encoder.module.").replace("pool.", "pool.module."): a for key, a in nanne.items()
    }
    parallel["pool.module.conv.bias"] = np.ones(64, np.float32)
    assert recognise(nanne) == recognise(parallel) == "netvlad-nanne"
    plain, several = netvlad.convert_nanne(nanne), netvlad.convert_nanne(parallel)
    assert several.keys() - plain.keys() == {"aggregation.bias"}
    assert all(np.array_equal(plain[key], several[key]) for key in plain)
    model = restore("netvlad-nanne", several)
    assert model.aggregation.bias is not None and model.whitening.kernel.shape == (32768, 128)
    without = {key: array for key, array in plain.items() if not key.startswith("whitening.")}
    bare = restore("netvlad-nanne", without)
    assert jax.eval_shape(bare, jnp.zeros((2, 64, 64, 3), jnp.float32)).shape == (2, 32768)
    with pytest.raises(ValueError, match=r"unexpected key 'pool\.scale'"):
        netvlad.convert_nanne({**nanne, "pool.scale": np.ones(1)})


def test_both_conventions_describe_alike_where_they_mean_the_same(nanne):
    """The same weights under MATLAB's layouts, with ImageNet's preprocessing undone in the first layer."""
    arrays = {key: array for key, array in netvlad.convert_nanne(nanne).items() if not key.startswith("whitening.")}
    struct = {}
    for key, array in seeded_state("netvlad_mat", 3).items():
        struct[key] = array
    for index in (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28):
        struct[f"layers.{index}.weights.0"] = nanne[f"encoder.{index}.weight"].transpose(2, 3, 1, 0)
        struct[f"layers.{index}.weights.1"] = nanne[f"encoder.{index}.bias"][None]
    deviation = np.array([0.229, 0.224, 0.225], np.float32)
    struct["layers.0.weights.0"] = struct["layers.0.weights.0"] / (255 * deviation)[:, None]
    struct["meta.normalization.averageImage"] = np.array([[[0.485, 0.456, 0.406]]], np.float32) * 255
    struct["layers.30.weights.0"] = nanne["pool.conv.weight"][:, :, 0, 0].T[None, None]
    struct["layers.30.weights.1"] = -nanne["pool.centroids"].T[None, None]
    del struct["layers.33.weights.0"]
    assert recognise(struct) == "netvlad"
    images = jnp.asarray(np.random.default_rng(0).uniform(size=(1, 48, 64, 3)), jnp.float32)
    theirs = restore("netvlad-nanne", arrays)(images)
    ours = restore("netvlad", netvlad.convert_matlab(struct))(images)
    np.testing.assert_allclose(ours.reshape(512, 64).T.reshape(-1), theirs[0], atol=2e-6)
    del struct["layers.26.weights.1"]
    with pytest.raises(ValueError, match=r"layers\.26\.weights\.1 is missing"):
        netvlad.convert_matlab(struct)
