"""Flattened maps and their components against NumPy's SVD; what is not seen says nothing."""

import jax.numpy as jnp
import numpy as np

from ebjax.places.flattened import COMPONENTS, flat, pooled, principal_directions, unite

RNG = np.random.default_rng(11)


def random_kept(views=20):
    maps = RNG.standard_normal((views, 2, 3, 4, 5)).astype(np.float16)
    return {"map": maps, "cells": np.ones(maps.shape[:4], bool)}


def test_directions_are_those_of_the_svd():
    rows = RNG.standard_normal((30, 200)) @ np.diag(np.linspace(3, 0.1, 200))
    rows -= rows.mean(0)
    found = np.asarray(principal_directions(jnp.asarray(rows)))
    _, spread, expected = np.linalg.svd(rows, full_matrices=False)
    assert found.shape == (200, 30) and spread[-1] < 1e-9
    assert not found[:, -1].any(), "the mean took one direction away"
    np.testing.assert_allclose(np.abs(np.sum(found[:, :29].T * expected[:29], 1)), 1, atol=1e-9)


def test_few_views_keep_their_cosines():
    kept = random_kept()
    rows = kept["map"].astype(np.float64)
    rows = (rows - rows.mean(0)).reshape(20, 2, -1)
    rows /= np.linalg.norm(rows, axis=2, keepdims=True)
    vectors = np.asarray(unite(kept).vectors, np.float64)
    assert vectors.shape[1] <= COMPONENTS
    np.testing.assert_allclose(vectors[..., 0] @ vectors[..., 1].T, rows[:, 0] @ rows[:, 1].T, atol=1e-4)


def test_cells_that_are_not_seen_take_the_mean():
    kept = random_kept()
    kept["cells"][3, :, :, 2:] = False
    first = np.asarray(unite(kept).vectors)
    kept["map"][3, :, :, 2:] = 9
    second = np.asarray(unite(kept).vectors)
    scores = [v[..., 0] @ v[..., 0].T for v in (first, second)]
    np.testing.assert_allclose(*scores, atol=1e-5)


def test_kept_maps_have_a_size_of_their_own():
    values = jnp.asarray(RNG.uniform(0, 5, (2, 4, 4, 6)).astype(np.float32))
    shown = np.ones((2, 32, 32), np.float32)
    shown[:, :, 16:] = 0
    one, ten = flat(values, jnp.asarray(shown)), flat(1e5 * values, jnp.asarray(shown))
    np.testing.assert_array_equal(one["map"], ten["map"])
    assert one["map"].dtype == jnp.float16 and np.isfinite(ten["map"]).all()
    np.testing.assert_array_equal(one["cells"], np.broadcast_to([True, True, False, False], (2, 4, 4)))
    mean = pooled(values, jnp.asarray(shown))["map"].astype(jnp.float32)
    expected = np.asarray(values)[:, :, :2].mean((1, 2))
    ratio = np.asarray(mean)[:, 0, 0] / expected
    assert mean.shape == (2, 1, 1, 6) and np.ptp(ratio) < 2e-3 * ratio.mean()
