import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.models.alike import VARIANTS, convert, detect, detect_maps
from ebjax.models.catalogue import recognise, restore


@pytest.fixture(scope="module")
def published(random_checkpoint):
    """A variant's checkpoint, of the published keys and shapes."""

    def make(variant):
        channels, dimension, two_layers = VARIANTS[variant]
        made = random_checkpoint()
        made.alike_blocks(channels, dimension)
        if two_layers:
            made.weight("convhead1.weight", dimension, dimension, 1, 1)
        made.weight("convhead2.weight", dimension + 1, dimension, 1, 1)
        return made.state

    return make


@pytest.fixture(scope="module")
def network(published):
    return restore("alike", convert(published("alike-t")))


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_variant_is_recognised_and_built(published, variant):
    state = published(variant)
    assert recognise(state) == "alike"
    channels, dimension, two_layers = VARIANTS[variant]
    made = restore("alike", convert(state))
    assert [getattr(made, f"block{n}").conv2.kernel.shape[3] for n in range(1, 5)] == list(channels)
    assert made.head2.kernel.shape == (1, 1, dimension, dimension + 1) and (made.head1 is not None) == two_layers


def test_normalisation_is_folded_into_its_convolution(published):
    state = published("alike-t")
    arrays = convert(state)
    x = np.random.default_rng(2).standard_normal((27,))
    for k, inside in ((1, 3), (2, 8)):
        y = state[f"block1.conv{k}.weight"].reshape(8, -1)[:, :27] @ x
        mean, var = state[f"block1.bn{k}.running_mean"], state[f"block1.bn{k}.running_var"]
        y = (y - mean) / np.sqrt(var + 1e-5) * state[f"block1.bn{k}.weight"] + state[f"block1.bn{k}.bias"]
        kernel = arrays[f"block1.conv{k}.kernel"].transpose(3, 2, 0, 1).reshape(8, -1)[:, :27]
        np.testing.assert_allclose(kernel @ x + arrays[f"block1.conv{k}.bias"], y, atol=1e-5)
        assert arrays[f"block1.conv{k}.kernel"].shape == (3, 3, inside, 8)


def test_wrong_keys_are_named(published):
    state = published("alike-t")
    with pytest.raises(ValueError, match=r"unexpected key 'other\.weight'"):
        convert({**state, "other.weight": np.zeros(3)})
    with pytest.raises(ValueError, match=r"'conv3\.weight' is missing"):
        convert({key: array for key, array in state.items() if key != "conv3.weight"})


def test_maps_have_the_size_of_any_image(network, image):
    scores, descriptors = network(image[None])
    assert scores.shape == (1, 50, 71) and descriptors.shape == (1, 50, 71, 64)
    assert (scores > 0).all() and (scores < 1).all()
    np.testing.assert_allclose(jnp.linalg.norm(descriptors, axis=-1), 1, atol=1e-5)


def test_detections_have_a_fixed_size_strongest_first(network, image):
    found = detect(network, image, count=30, threshold=0.0)
    assert found.keypoints.shape == (30, 2) and found.valid.all()
    scores, _ = network(image[None])
    few = detect(network, image, count=30, threshold=float(jnp.quantile(scores, 0.999)))
    assert 0 < few.valid.sum() < 30 and not few.valid[few.valid.sum() :].any()
    whole = detect(network, image, count=30, threshold=0.0, sub_pixel=False)
    np.testing.assert_array_equal(whole.keypoints, jnp.round(whole.keypoints))
    assert 0 < jnp.abs(whole.keypoints - found.keypoints).max() <= 2
    assert not detect(network, image, count=30, threshold=0.9999).valid.any()


def test_places_and_descriptors_are_differentiable_in_the_maps(network, image):
    scores, descriptors = (m[0].astype(jnp.float64) for m in network(image[None]))
    random = np.random.default_rng(3)
    step = jnp.asarray(random.standard_normal(scores.shape)), jnp.asarray(random.standard_normal(descriptors.shape))
    weight = jnp.asarray(random.standard_normal((8, 64)))

    def value(t):
        found = detect_maps(scores + t * step[0], descriptors + t * step[1], count=8, threshold=0.0, sub_pixel=True)
        return (found.keypoints**2).sum() + (found.descriptors * weight).sum() + found.scores.sum()

    numeric = (value(1e-7) - value(-1e-7)) / 2e-7
    np.testing.assert_allclose(jax.grad(value)(0.0), numeric, rtol=1e-4)
