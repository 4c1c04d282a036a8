"""A floor of random texture, views of it, their dense maps and the space learned from them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from ebjax.models.catalogue import MODELS, resolve
from ebjax.models.seeded import seeded_state
from ebjax.models.weights import save_weights
from ebjax.places.descriptor_map import dense, learn_space

STATE = {"netvlad": "netvlad_mat"}


def texture(shape, seed=0, sigma=1.5):
    """Smooth noise in [0, 1], float32."""
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal(shape), sigma)
    return ((noise - noise.min()) / np.ptp(noise)).astype(np.float32)


@pytest.fixture(scope="session")
def floor_texture():
    return texture


@pytest.fixture(scope="session")
def dense_all():
    """Views and what is seen of them -> dense maps."""
    return jax.jit(lambda views, seen: jax.lax.map(lambda view: dense(view, seen)[0], views))


@pytest.fixture(scope="session")
def maps(dense_all):
    return dense_all(np.stack([texture((96, 96), seed) for seed in range(6)]), jnp.ones((96, 96), jnp.float32))


@pytest.fixture(scope="session")
def space(maps):
    """Learned with a field of view that has no symmetry."""
    mask = np.ones(maps.shape[1:3], bool)
    mask[:2, :3] = mask[:2, -4:] = mask[-1] = False
    return learn_space(maps, mask, 16)


@pytest.fixture(scope="session")
def weights(tmp_path_factory):
    """Name -> a folder with stand-in weights of that network, made when it is asked for."""
    folder = tmp_path_factory.mktemp("weights")

    def of(name):
        file = folder / f"{name}.safetensors"
        if name in MODELS and not file.exists():
            state = seeded_state(STATE.get(name, name), 2, head=name != "vgg19")
            save_weights(file, name, resolve(MODELS[name].convert)(state))
        return folder

    return of
