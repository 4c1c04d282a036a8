import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.models.aliked import DEFORMED, SCORE, VARIANTS, convert, detect
from ebjax.models.catalogue import recognise, restore
from ebjax.models.deform import deform_conv


@pytest.fixture(scope="module")
def published(random_checkpoint):
    """A variant's checkpoint, of the published keys and shapes."""

    def make(variant):
        channels, dimension, places = VARIANTS[variant]
        made = random_checkpoint(gain=1.0)
        made.alike_blocks(channels, dimension, DEFORMED)
        before = dimension
        for n, (width, size) in enumerate(SCORE):
            made.weight(f"score_head.{2 * n}.weight", width, before, size, size, gain=2.0)
            before = width
        made.weight("desc_head.offset_conv.0.weight", 2 * places, dimension, 3, 3)
        made.weight("desc_head.offset_conv.2.weight", 2 * places, 2 * places, 1, 1)
        for n in (0, 2):
            made.uniform(f"desc_head.offset_conv.{n}.bias", 2 * places, -1, 1)
        made.weight("desc_head.sf_conv.weight", dimension, dimension, 1, 1)
        made.weight("desc_head.agg_weights", places, dimension, dimension)
        return made.state

    return make


@pytest.fixture(scope="module")
def network(published):
    return restore("aliked", convert(published("aliked-t16")))


def test_published_keys_are_recognised_and_wrong_ones_named(published):
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
