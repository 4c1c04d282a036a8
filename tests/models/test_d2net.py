import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from scipy.ndimage import gaussian_filter

from ebjax.models.d2net import D2Net, convert, detect, hard_detection, soft_scores
from ebjax.models.seeded import seeded_state
from ebjax.models.weights import load_into

SIDE = 96
ARRAYS = convert(seeded_state("d2net", 3))


def restored(change, **options):
    """D2-Net with stand-in weights that went through `change`."""
    arrays = {key: change(array) if array.ndim == 4 else array for key, array in ARRAYS.items()}
    made = nnx.eval_shape(lambda: D2Net(rngs=nnx.Rngs(0), **options))
    load_into(made, arrays)
    return made


@pytest.fixture(scope="module")
def network():
    return restored(np.asarray)


@pytest.fixture(scope="module")
def image():
    noise = np.random.default_rng(0).standard_normal((SIDE, SIDE, 3))
    blurred = gaussian_filter(noise, (1.5, 1.5, 0))
    return jnp.asarray(np.clip(0.5 + 0.2 * blurred / blurred.std(), 0, 1), jnp.float32)


@pytest.mark.slow
def test_a_cell_looks_at_the_pixels_around_its_exact_centre():
    (graph, positive), side, cell = nnx.split(restored(np.abs)), 128, 15
    random, seen = np.random.default_rng(0), np.zeros((side, side))
    # The weights are an argument: as constants they would be folded while the program is compiled.
    read = jax.jit(jax.grad(lambda x, weights: nnx.merge(graph, weights)(x)[0, cell, cell].sum()))
    for _ in range(6):  # of every four pixels a pool passes one on
        slope = read(jnp.asarray(1 + random.random((1, side, side, 3)), jnp.float32), positive)
        seen += np.abs(np.asarray(slope[0])).sum(-1)
    first, last = np.flatnonzero(seen.sum(0))[[0, -1]]
    assert (first + last) / 2 == 4 * cell + 3.5 and last - first == 91


def test_shapes_of_both_forms_and_the_last_relu(image):
    test, training = (restored(np.asarray, **o) for o in ({}, {"form": "training", "final_relu": False}))
    tested, trained = (np.asarray(network(image[None, :80, :])) for network in (test, training))
    assert tested.shape == (1, 80 // 4 - 1, SIDE // 4 - 1, 512)
    assert trained.shape == (1, 80 // 8, SIDE // 8, 512)
    assert (tested >= 0).all() and (trained < 0).any()


def test_detections_have_a_fixed_size_and_come_strongest_first(network, image):
    found = detect(network, image, count=40)
    assert found.keypoints.shape == (40, 2) and found.descriptors.shape == (40, 512)
    scores = np.asarray(found.scores)[np.asarray(found.valid)]
    assert (np.diff(scores) <= 0).all()
    np.testing.assert_allclose(jnp.linalg.norm(found.descriptors[found.valid], axis=1), 1, atol=1e-5)
    flat = detect(network, jnp.full((64, 64, 3), 0.5), count=40)
    assert flat.keypoints.shape == (40, 2) and np.isfinite(flat.descriptors).all()


def test_localisation_finds_the_top_of_a_paraboloid():
    y, x = jnp.meshgrid(jnp.arange(9.0), jnp.arange(11.0), indexing="ij")
    top = jnp.array([5.3, 3.8])
    bowl = 9 - (x - top[0]) ** 2 - 0.7 * (y - top[1]) ** 2 + 0.4 * (x - top[0]) * (y - top[1])
    dense = jnp.stack([bowl, 0.3 * bowl], -1)
    found, channel, step = hard_detection(dense)
    assert found[4, 5] and channel[4, 5] == 0 and found.sum() == 1
    np.testing.assert_allclose(step[4, 5], top - jnp.array([5.0, 4.0]), atol=1e-9)
    ridge = jnp.stack([9 - (x - 5) ** 2 - 0.01 * (y - 4) ** 2, jnp.zeros_like(x)], -1)
    assert not hard_detection(ridge)[0].any()


def test_soft_scores_are_the_papers():
    dense = np.random.default_rng(0).standard_normal((5, 6, 4))
    positive = np.maximum(dense, 0)
    exponential = np.exp(positive / positive.max())
    score = np.zeros((5, 6))
    for i in range(5):
        for j in range(6):
            for k in range(4):
                rows = [(i + a, j + b) for a in (-1, 0, 1) for b in (-1, 0, 1)]
                total = sum(exponential[r, c, k] if 0 <= r < 5 and 0 <= c < 6 else 1.0 for r, c in rows)
                ratio = positive[i, j, k] / (positive[i, j].max() + 1e-6)
                score[i, j] = max(score[i, j], exponential[i, j, k] / total * ratio)
    np.testing.assert_allclose(soft_scores(jnp.asarray(dense)), score / (score.sum() + 1e-6), atol=1e-12)


@pytest.mark.slow
def test_soft_scores_train():
    dense, step = (jnp.asarray(np.random.default_rng(k).standard_normal((6, 7, 5))) for k in (0, 1))
    weight = jnp.asarray(np.random.default_rng(2).random((6, 7)))

    def value(t):
        return (soft_scores(dense + t * step) * weight).sum()

    np.testing.assert_allclose(jax.grad(value)(0.0), (value(1e-6) - value(-1e-6)) / 2e-6, rtol=1e-5)
    for empty in (jnp.zeros((4, 4, 3)), -jnp.ones((4, 4, 3))):
        assert np.isfinite(jax.grad(lambda d: (soft_scores(d) ** 2).sum())(empty)).all()
