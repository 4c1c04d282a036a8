"""The whole search on an out-and-back-and-out run over a random floor: places found from both sides."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.places.descriptor_map import MIN_SUPPORT, STRIDE_PX, dense
from ebjax.places.recall import facing_pairs, precision_100, recall_at_1
from ebjax.places.retrieve import comparable
from ebjax.places.rootsift_vlad import unite
from ebjax.places.search import search

SIZE, STEP, STATIONS = 96, 24, 12
METRES_PER_PX = 0.01


@pytest.fixture(scope="module")
def run(floor_texture, dense_all):
    """Forth, back and forth again along a strip of floor, 24 px a step, some px to the side, other light and noise."""
    rng = np.random.default_rng(0)
    texture = floor_texture((SIZE + STEP * (STATIONS + 1), SIZE + 40), 11, 2.0)
    stations = [*range(STATIONS), *range(STATIONS)[::-1], *range(STATIONS)]
    back = np.repeat([False, True, False], STATIONS)
    columns = np.concatenate([np.full(STATIONS, 20), np.full(STATIONS, 28), np.full(STATIONS, 12)])
    views, poses = [], []
    for station, away, column in zip(stations, back, columns, strict=True):
        row = STEP * (STATIONS - station)
        view = texture[row : row + SIZE, column : column + SIZE]
        view = np.rot90(view, 2) if away else view
        views.append(np.clip(view * rng.uniform(0.8, 1.1) + rng.normal(0, 0.01, view.shape), 0, 1).astype(np.float32))
        poses.append([-row * METRES_PER_PX, -column * METRES_PER_PX, np.pi * away])
    seen = np.ones((SIZE, SIZE), np.float32)
    seen[:, :8] = 0
    maps, support = dense_all(np.stack(views), jnp.asarray(seen)), dense(jnp.zeros_like(seen), jnp.asarray(seen))[1]
    poses, steps = np.array(poses), np.arange(len(views), dtype=float)
    allowed = comparable(jnp.asarray(steps), jnp.asarray(steps * STEP * METRES_PER_PX), 2.0, 1.0)
    cells = np.broadcast_to(np.asarray(support) > MIN_SUPPORT, maps.shape[:3])
    kept = {"map": np.asarray(maps.astype(jnp.float16)), "cells": cells}
    return kept, unite(kept), allowed, poses


def found_by(run, ranking):
    _, places, allowed, _ = run
    return jax.tree.map(np.asarray, search(places, allowed, ranking=ranking))


@pytest.mark.slow
@pytest.mark.parametrize("ranking", ["correlation", "cosine"])
def test_every_place_is_found_from_the_other_side_and_again_from_the_same(run, ranking):
    poses = run[3]
    found = found_by(run, ranking)
    first = np.where(found.valid[:, 0], found.j[:, 0], -1)
    pairs = facing_pairs(poses, np.zeros(2), 0.2)
    returning = slice(0, 2 * STATIONS)
    share, queries = recall_at_1(first[returning], found.opposing[returning, 0], pairs[returning, returning])
    # At the turn the robot stands on the same place: those two views are too close in time to be compared.
    assert queries == STATIONS and share is not None and share >= 1 - 2 / STATIONS
    station = np.array([*range(STATIONS), *range(STATIONS)[::-1], *range(STATIONS)])
    for i in range(STATIONS + 2, 2 * STATIONS):
        assert station[found.j[i, 0]] == station[i] and found.opposing[i, 0]
    for i in range(2 * STATIONS + 2, 3 * STATIONS):
        same = found.valid[i] & ~found.opposing[i]
        assert station[found.j[i, np.argmax(same)]] == station[i], "the same direction is found too"
        assert station[found.j[i, 0]] == station[i]
    right = (station[first] == station) & (first >= 0)
    asked = np.arange(len(first)) >= STATIONS + 2
    assert precision_100(1.0 - found.distance[asked, 0].astype(float), right[asked]) > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("ranking", ["correlation", "cosine"])
def test_candidates_are_allowed_ranked_and_unique(run, ranking):
    found = found_by(run, ranking)
    _, places, allowed, _ = run
    rows = np.arange(len(places.vectors))[:, None]
    assert (found.i == rows).all() and found.j.dtype == np.int32 and found.distance.dtype == np.float32
    assert np.asarray(allowed)[rows, found.j, found.opposing.astype(int)][found.valid].all()
    np.testing.assert_array_equal(found.valid.sum(1), np.minimum(np.asarray(allowed).sum(1), 20).sum(1))
    for distance, valid, j, way in zip(found.distance, found.valid, found.j, found.opposing, strict=True):
        assert (np.diff(distance[valid]) >= 0).all() and (np.diff(valid.astype(int)) <= 0).all()
        assert len({*zip(j[valid], way[valid], strict=True)}) == valid.sum()


@pytest.mark.slow
def test_shift_measures_the_loop(run):
    found, poses = found_by(run, "correlation"), run[3]
    heading = poses[:, 2]
    for i in range(STATIONS + 2, 3 * STATIONS):
        if not found.valid[i, 0]:
            continue
        offset = poses[i, :2] - poses[found.j[i, 0], :2]
        ahead_left = np.cos(heading[i]) * offset
        np.testing.assert_allclose(found.shift[i, 0] * STRIDE_PX * METRES_PER_PX, ahead_left, atol=1e-6)


def test_chosen_queries_get_the_same_answers(run):
    _, places, allowed, _ = run
    queries = np.array([30, 17])
    rows = search(places, allowed[queries], queries=queries)
    everything = found_by(run, "correlation")
    np.testing.assert_array_equal(rows.i[:, 0], queries)
    for row, query in enumerate(queries):
        valid = everything.valid[query]
        np.testing.assert_array_equal(np.asarray(rows.j)[row][valid], everything.j[query][valid])
        np.testing.assert_allclose(np.asarray(rows.distance)[row][valid], everything.distance[query][valid], atol=1e-5)


def test_a_second_search_compiles_nothing(run, caplog):
    found_by(run, "correlation")
    with jax.log_compiles():
        found_by(run, "correlation")
    assert not [record.message for record in caplog.records if "Compiling" in record.message]


def test_vectors_alone_are_ranked_by_cosine(run):
    _, places, allowed, _ = run
    bare = dataclasses.replace(places, maps=None, space=None)
    found = search(bare, allowed)
    np.testing.assert_array_equal(found.j, found_by(run, "cosine").j)
    with pytest.raises(ValueError, match="no maps to correlate"):
        search(bare, allowed, ranking="correlation")


def test_correlation_is_ranked_by_its_mean_with_the_cosine(run):
    _, places, allowed, _ = run
    alone = search(dataclasses.replace(places, share=1e9), allowed)
    i, j, way = (np.asarray(part)[20, 0] for part in (alone.i, alone.j, alone.opposing))
    cosine = np.asarray(places.vectors)[i, :, 0] @ np.asarray(places.vectors)[j, :, int(way)]
    for share in (0.5, 1.0):
        found = search(dataclasses.replace(places, share=share), allowed)
        row = np.flatnonzero((np.asarray(found.j)[20] == j) & (np.asarray(found.opposing)[20] == way))[0]
        expected = (cosine + share * (1 - np.asarray(alone.distance)[20, 0])) / (1 + share)
        np.testing.assert_allclose(1 - np.asarray(found.distance)[20, row], expected, atol=1e-5)


def test_bad_input_says_what_to_do(run):
    _, places, allowed, _ = run
    with pytest.raises(ValueError, match="choose auto, correlation, cosine"):
        search(places, allowed, ranking="best")
