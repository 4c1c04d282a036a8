import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from ebjax.features.equivariance import stand_in, through_turn
from ebjax.models.d2net import SCALES


@pytest.fixture(scope="module")
def network():
    return stand_in(3)


@pytest.fixture(scope="module")
def image():
    blurred = gaussian_filter(np.random.default_rng(0).standard_normal((96, 96, 3)), (1.5, 1.5, 0))
    return jnp.asarray(np.clip(0.5 + 0.2 * blurred / blurred.std(), 0, 1), jnp.float32)


def test_a_turned_image_has_the_turned_map(network, image):
    turned = network(image[None, ::-1, ::-1])[:, ::-1, ::-1]
    np.testing.assert_allclose(turned, network(image[None]), atol=1e-4 * float(turned.max()))


def test_exact_keypoints_are_the_same_through_a_turn_by_pi(network, image):
    here, there = through_turn(network, image, "exact", SCALES)
    assert len(here) > 40 and np.abs(there - here).max() < 0.1


def test_official_keypoints_are_four_pixels_off(network, image):
    here, there = through_turn(network, image, "official")
    assert len(here) > 20
    np.testing.assert_allclose(there - here, 4, atol=0.1)


def test_another_phase_of_the_cells_is_refused(network, image):
    with pytest.raises(ValueError, match="sides that are multiples of 4"):
        through_turn(network, image[:-1, :-2], "exact")
