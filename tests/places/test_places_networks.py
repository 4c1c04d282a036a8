"""NetVLAD with and without a mask against the published network; SuperPoint's words."""

import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.models.catalogue import load_network
from ebjax.models.layers import normalise
from ebjax.places.netvlad import read
from ebjax.places.superpoint import unite

RNG = np.random.default_rng(3)


@pytest.fixture(scope="module")
def network(weights):
    return load_network(weights("netvlad") / "netvlad.safetensors")[1]


def test_netvlad_of_a_whole_view_is_the_published_one(network):
    images = jnp.asarray(RNG.uniform(size=(2, 64, 80, 3)).astype(np.float32))
    vectors = read(network, images, jnp.ones((2, 64, 80), jnp.float32))["vectors"]
    np.testing.assert_allclose(vectors, network(images), atol=1e-6)


def test_netvlad_sums_over_what_is_seen(network):
    images = jnp.asarray(RNG.uniform(size=(2, 64, 80, 3)).astype(np.float32))
    shown = np.ones((2, 64, 80), np.float32)
    shown[:, :, 48:] = 0
    maps = network.backbone.taps(network.preprocess(images), ("conv5_3",))["conv5_3"]
    expected = network.whitening(network.aggregation(maps[:, :, :3]))
    np.testing.assert_allclose(read(network, images, jnp.asarray(shown))["vectors"], expected, atol=1e-6)


@pytest.mark.slow
def test_superpoint_s_hidden_cells_say_nothing():
    maps = np.asarray(normalise(jnp.asarray(RNG.standard_normal((10, 2, 4, 5, 16)))), np.float16)
    cells = np.ones(maps.shape[:4], bool)
    cells[:, :, 0] = False
    first = unite({"map": maps, "cells": cells}, seed=3).vectors
    again = maps.copy()
    again[:, :, 0] = 1
    np.testing.assert_array_equal(unite({"map": again, "cells": cells}, seed=3).vectors, first)
    with pytest.raises(ValueError, match="look at more floor"):
        unite({"map": maps, "cells": np.zeros_like(cells)})
