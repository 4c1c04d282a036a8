"""What words say of views: turned views, unseen cells, bursts."""

import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.places.descriptor_map import MapSpace, rotate_pi_map
from ebjax.places.vlad import Vocabulary
from ebjax.places.words import _describe, by_words

SIZE, D = (6, 8), 4
PARITY = np.array([1.0, 1.0, -1.0, -1.0])


def space_of(mask):
    return MapSpace(jnp.zeros((*SIZE, D)), jnp.eye(D), jnp.asarray(PARITY), jnp.asarray(mask, jnp.float64))


@pytest.fixture(scope="module")
def run():
    """Views, each followed by itself turned by pi: what is learned from them is the same both ways."""
    values = np.random.default_rng(0).standard_normal((10, *SIZE, D))
    values[:, :2, :3] = values[:, -2:, -3:] = 0
    views = jnp.asarray(values)
    space = space_of((values != 0).any((0, 3)))
    both = jnp.stack([views, rotate_pi_map(views, space)], 1).reshape(-1, *SIZE, D)
    return (space, *by_words(both, space))


def test_a_turned_view_has_the_turned_map_and_its_vectors_change_places(run):
    space, vectors, weighed = run
    np.testing.assert_allclose(weighed[1::2], rotate_pi_map(weighed[::2], space), atol=1e-9)
    np.testing.assert_allclose(vectors[1::2], vectors[::2, :, ::-1], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1, atol=1e-9)


def test_unseen_cells_stay_zero_and_do_not_count():
    values = np.random.default_rng(1).standard_normal((6, *SIZE, D))
    hidden = values.copy()
    hidden[5, :, :4] = 0
    mask = np.ones(SIZE)
    (seen, _), (half, weighed) = (by_words(jnp.asarray(v), space_of(mask)) for v in (values, hidden))
    assert not np.asarray(weighed)[5, :, :4].any() and np.asarray(weighed)[5, :, 4:].any()
    assert float(half[5, :, 0] @ half[5, :, 0]) == pytest.approx(1) and np.abs(half[5] - seen[5]).max() > 0.01


def test_n_cells_of_one_word_weigh_as_the_square_root():
    words = Vocabulary(jnp.eye(D)[:2], jnp.asarray(1e3))
    values = np.zeros((1, *SIZE, D))
    values.reshape(-1, D)[:15, 0] = 1
    values.reshape(-1, D)[15, 1] = 1
    _, weighed = _describe(jnp.asarray(values), words, jnp.asarray(PARITY))
    weights = np.linalg.norm(weighed, axis=-1).reshape(-1)
    np.testing.assert_allclose(weights[:15] / weights[15], np.sqrt(2 / 16), atol=1e-9)
    assert not weights[16:].any()
