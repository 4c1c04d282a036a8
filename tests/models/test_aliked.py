import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.models.aliked import SCORE, VARIANTS, convert, detect
from ebjax.models.catalogue import recognise, restore
from ebjax.models.deform import deform_conv


def published(variant, seed=0):
    """A checkpoint of the published keys and shapes."""
    random = np.random.default_rng(seed)
    channels, dimension, places = VARIANTS[variant]
    state, before = {}, 3

    def add(key, *shape, gain=1.0):
        state[key] = (random.standard_normal(shape) * (gain / np.prod(shape[1:])) ** 0.5).astype(np.float32)

    for n, width in enumerate(channels, 1):
        for k, inside in ((1, before), (2, width)):
            name = f"block{n}.conv{k}"
            if n > 2:
                add(f"{name}.offset_conv.weight", 18, inside, 3, 3)
                state[f"{name}.offset_conv.bias"] = random.uniform(-1, 1, 18).astype(np.float32)
                name += ".regular_conv"
            add(f"{name}.weight", width, inside, 3, 3)
            for part, (low, high) in {"weight": (0.6, 1.4), "bias": (-0.2, 0.2), "running_mean": (-0.2, 0.2)}.items():
                state[f"block{n}.bn{k}.{part}"] = random.uniform(low, high, width).astype(np.float32)
            state[f"block{n}.bn{k}.running_var"] = random.uniform(0.5, 1.5, width).astype(np.float32)
            state[f"block{n}.bn{k}.num_batches_tracked"] = np.array(3)
        if n > 1:
            add(f"block{n}.downsample.weight", width, before, 1, 1)
            state[f"block{n}.downsample.bias"] = random.uniform(-0.1, 0.1, width).astype(np.float32)
        add(f"conv{n}.weight", dimension // 4, width, 1, 1)
        before = width
    before = dimension
    for n, (width, size) in enumerate(SCORE):
        add(f"score_head.{2 * n}.weight", width, before, size, size, gain=2)
        before = width
    add("desc_head.offset_conv.0.weight", 2 * places, dimension, 3, 3)
    add("desc_head.offset_conv.2.weight", 2 * places, 2 * places, 1, 1)
    for n in (0, 2):
        state[f"desc_head.offset_conv.{n}.bias"] = random.uniform(-1, 1, 2 * places).astype(np.float32)
    add("desc_head.sf_conv.weight", dimension, dimension, 1, 1)
    add("desc_head.agg_weights", places, dimension, dimension)
    return state


@pytest.fixture(scope="module")
def network():
    return restore("aliked", convert(published("aliked-t16")))


@pytest.fixture(scope="module")
def image():
    return jnp.asarray(np.random.default_rng(1).random((50, 71, 3)), jnp.float32)


def test_published_keys_are_recognised_and_wrong_ones_named():
    for variant, (channels, dimension, places) in VARIANTS.items():
        state = published(variant)
        assert recognise(state) == "aliked"
        made = restore("aliked", convert(state))
        assert made.merge.shape == (places, dimension, dimension)
        assert [getattr(made, f"block{n}").conv2.kernel.shape[3] for n in range(1, 5)] == list(channels)
    with pytest.raises(ValueError, match=r"unexpected key 'other\.weight'"):
        convert({**state, "other.weight": np.zeros(3)})
    with pytest.raises(ValueError, match=r"'block3\.conv1\.offset_conv\.bias' is missing"):
        convert({key: array for key, array in state.items() if key != "block3.conv1.offset_conv.bias"})
    with pytest.raises(ValueError, match="these are not the weights of ALIKED"):
        restore("aliked", {"merge": np.zeros((1, 1, 1))})


def naive(x, offsets, kernel):
    """The definition, number by number: the mean of four pixels by how near they are, zero outside."""
    height, width, channels = x.shape
    y = np.zeros((height, width, kernel.shape[3]))
    for v, u, k in np.ndindex(height, width, 9):
        at_x, at_y = u + k % 3 - 1 + offsets[v, u, k, 0], v + k // 3 - 1 + offsets[v, u, k, 1]
        value = np.zeros(channels)
        for row in (int(np.floor(at_y)), int(np.floor(at_y)) + 1):
            for column in (int(np.floor(at_x)), int(np.floor(at_x)) + 1):
                if 0 <= row < height and 0 <= column < width:
                    value += x[row, column] * (1 - abs(at_y - row)) * (1 - abs(at_x - column))
        y[v, u] += value @ kernel[k // 3, k % 3]
    return y


def test_deformable_convolution_is_its_definition():
    random = np.random.default_rng(4)
    x, kernel = random.standard_normal((2, 6, 7, 3)), random.standard_normal((3, 3, 3, 4))
    offsets, bias = random.uniform(-2.5, 2.5, (2, 6, 7, 9, 2)), random.standard_normal(4)
    given = [jnp.asarray(array) for array in (x, offsets, kernel, bias)]
    found = deform_conv(*given)
    for n in range(2):
        np.testing.assert_allclose(found[n], naive(x[n], offsets[n], kernel) + bias, atol=1e-9)
    plain = jax.lax.conv_general_dilated(
        given[0], given[2], (1, 1), "SAME", dimension_numbers=("NHWC", "HWIO", "NHWC"), precision="highest"
    )
    still = deform_conv(given[0], jnp.zeros_like(given[1]), *given[2:]) - given[3][None, None, None, :]
    np.testing.assert_allclose(still, plain, atol=1e-9)


def test_deformable_convolution_is_differentiable_in_all():
    random = np.random.default_rng(5)
    shapes = (1, 5, 6, 2), (1, 5, 6, 9, 2), (3, 3, 2, 3), (3,)
    given = [jnp.asarray(random.uniform(-0.9, 0.9, shape)) for shape in shapes]
    steps = [jnp.asarray(random.standard_normal(shape)) for shape in shapes]

    def value(t):
        return (deform_conv(*(a + t * s for a, s in zip(given, steps, strict=True))) ** 2).sum()

    np.testing.assert_allclose(jax.grad(value)(0.0), (value(1e-7) - value(-1e-7)) / 2e-7, rtol=1e-5)


def test_maps_have_the_size_of_any_image(network, image):
    scores, features = network(image[None])
    assert scores.shape == (1, 50, 71) and features.shape == (1, 50, 71, 64)
    assert (scores > 0).all() and (scores < 1).all()
    np.testing.assert_allclose(jnp.linalg.norm(features, axis=-1), 1, atol=1e-5)


def test_detections_have_a_fixed_size_strongest_first(network, image):
    found = detect(network, image, count=20, threshold=0.0)
    assert found.keypoints.shape == (20, 2) and found.descriptors.shape == (20, 64) and found.valid.all()
    np.testing.assert_allclose(jnp.linalg.norm(found.descriptors, axis=1), 1, atol=1e-5)
    assert not detect(network, image, count=20, threshold=0.9999).valid.any()


def test_places_and_descriptors_are_differentiable_in_the_features(network, image):
    features = network(image[None])[1][0].astype(jnp.float64)
    random = np.random.default_rng(3)
    step, keypoints = jnp.asarray(random.standard_normal(features.shape)), jnp.asarray(random.uniform(9, 40, (6, 2)))
    weight = jnp.asarray(random.standard_normal((6, 64)))

    def value(t):
        return (network.describe(features + t * step, keypoints + t) * weight).sum()

    np.testing.assert_allclose(jax.grad(value)(0.0), (value(1e-7) - value(-1e-7)) / 2e-7, rtol=1e-4)
