"""Filling, resizing and masking commute with turning by pi."""

import jax.numpy as jnp
import numpy as np

from ebjax.models.luma import luma
from ebjax.places.view import cells_seen, filled, resized, unit

RNG = np.random.default_rng(6)


def test_unseen_pixels_take_the_mean_colour_of_the_seen():
    view, seen = RNG.uniform(size=(6, 7, 3)), np.zeros((6, 7))
    seen[2:, :4] = 1
    found = np.asarray(filled(jnp.asarray(view), jnp.asarray(seen)))
    np.testing.assert_allclose(found[seen > 0], view[seen > 0])
    np.testing.assert_allclose(found[seen == 0], np.broadcast_to(view[seen > 0].mean(0), (26, 3)))
    assert np.isfinite(filled(jnp.asarray(view), jnp.zeros((6, 7)))).all()


def test_resizing_keeps_the_longer_side_and_turns_along():
    view = jnp.asarray(RNG.uniform(size=(60, 90, 3)))
    small = resized(view, 30)
    assert small.shape == (20, 30, 3)
    np.testing.assert_allclose(resized(view[::-1, ::-1], 30), small[::-1, ::-1], atol=1e-9)
    np.testing.assert_array_equal(resized(view, 90), view)


def test_half_a_cell_is_enough():
    seen = np.zeros((1, 32, 32))
    seen[:, :, 11:] = 1
    np.testing.assert_array_equal(cells_seen(jnp.asarray(seen), (2, 4))[0, 0], [False, True, True, True])


def test_grey_and_unit():
    np.testing.assert_allclose(luma(jnp.ones((2, 3, 3))), 1)
    np.testing.assert_allclose(unit(jnp.array([[3.0, 4.0], [0.0, 0.0]])), [[0.6, 0.8], [0, 0]])
