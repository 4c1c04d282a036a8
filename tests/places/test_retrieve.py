"""Which views may be compared, the cosine ranking against NumPy, and the merging of both directions."""

import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.places.retrieve import comparable, cosine_top_k, merge, shortlist

RNG = np.random.default_rng(7)


def test_comparable_leaves_out_the_future_and_what_is_near():
    times, travelled = np.array([0.0, 2, 4, 10, 12]), np.array([0.0, 1, 1.5, 2, 6])
    allowed = np.asarray(comparable(jnp.asarray(times), jnp.asarray(travelled), 5.0, 4.0))
    for i in range(5):
        for j in range(5):
            opposing = j < i and times[i] - times[j] >= 5
            assert allowed[i, j, 1] == opposing
            assert allowed[i, j, 0] == (opposing and travelled[i] - travelled[j] >= 4)
    assert allowed[..., 1].sum() == 6 and allowed[..., 0].sum() == 3


def test_equal_times_are_still_causal():
    allowed = comparable(jnp.zeros(4), jnp.zeros(4), 0.0, 0.0)
    np.testing.assert_array_equal(np.asarray(allowed)[..., 0], np.tri(4, k=-1, dtype=bool))


def test_cosine_top_k_is_a_sorted_product():
    vectors = RNG.standard_normal((30, 8)).astype(np.float32)
    allowed = np.tri(30, k=-3, dtype=bool) & (RNG.random((30, 30)) < 0.8)
    best, index = (np.asarray(a) for a in cosine_top_k(vectors, vectors, allowed, k=6))
    scores = np.where(allowed, vectors @ vectors.T, -np.inf)
    order = np.argsort(-scores, axis=1, kind="stable")[:, :6]
    np.testing.assert_allclose(best, np.take_along_axis(scores, order, 1), rtol=1e-5)
    valid = np.isfinite(best)
    np.testing.assert_array_equal(valid.sum(1), np.minimum(allowed.sum(1), 6))
    np.testing.assert_array_equal(index[valid], order[valid])
    assert best.dtype == np.float32 and index.dtype == np.int32
    assert (index < np.arange(30)[:, None])[valid].all()


@pytest.mark.parametrize("queries, references", [(1, 3000), (2, 500), (40, 600)])
def test_the_best_twenty_are_exactly_those_of_float64(queries, references):
    ours, theirs = (RNG.standard_normal((n, 512)) for n in (queries, references))
    ours, theirs = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (ours, theirs))
    best, index = (np.asarray(a) for a in cosine_top_k(*(jnp.asarray(x, jnp.float32) for x in (ours, theirs)), k=20))
    scores = ours.astype(np.float32).astype(np.float64) @ theirs.astype(np.float32).astype(np.float64).T
    expected = -np.sort(-scores, axis=1)[:, :20]
    # Neighbours closer than float32's rounding may change places; nothing better is ever left out.
    np.testing.assert_allclose(np.take_along_axis(scores, index, 1), expected, atol=3e-7)
    np.testing.assert_allclose(best, expected, atol=3e-7)
    assert all(len(set(row)) == 20 for row in index)


def test_of_equal_scores_the_earlier_view_comes_first():
    same = np.ones((6, 2), np.float32)
    _, index = cosine_top_k(same, same, np.ones((6, 6), bool), k=4)
    np.testing.assert_array_equal(index, np.broadcast_to(np.arange(4), (6, 4)))


def test_more_candidates_than_views():
    vectors = RNG.standard_normal((3, 4, 2)).astype(np.float32)
    cosine, j = shortlist(vectors, np.arange(3, dtype=np.int32), np.ones((3, 3, 2), bool), k=20)
    assert cosine.shape == j.shape == (3, 2, 3)


def test_a_crowded_direction_leaves_the_other_its_places():
    vectors = np.zeros((9, 3, 2), np.float32)
    vectors[..., 0, 0] = 1
    vectors[..., 1, 1] = 1  # opposing cosines are all below those of the same direction
    cosine, j = shortlist(vectors, np.array([8], np.int32), np.ones((1, 9, 2), bool), k=2)
    np.testing.assert_allclose(cosine[0], [[1, 1], [0, 0]])
    np.testing.assert_array_equal(j[0], [[0, 1], [0, 1]])


def test_merge_ranks_both_directions_and_puts_invalid_last():
    score = np.array([[[0.3, 0.9], [0.5, 0.99]]], np.float32)
    valid = np.array([[[True, True], [True, False]]])
    j = np.array([[[4, 5], [6, 7]]], np.int32)
    shift = np.arange(8, dtype=np.int32).reshape(1, 2, 2, 2)
    merged = merge(np.array([11], np.int32), j, score, shift, valid)
    np.testing.assert_array_equal(merged.i, [[11] * 4])
    np.testing.assert_array_equal(merged.j, [[5, 6, 4, 7]])
    np.testing.assert_array_equal(merged.opposing, [[False, True, False, True]])
    np.testing.assert_array_equal(merged.valid, [[True, True, True, False]])
    np.testing.assert_allclose(merged.distance[0, :3], [0.1, 0.5, 0.7], rtol=1e-6)
    np.testing.assert_array_equal(merged.shift[0, :, 0], [2, 4, 0, 6])
