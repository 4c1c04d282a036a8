import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.models.floornet import parity
from ebjax.places.correlation import correlate, overlap_weight, spectrum
from ebjax.places.descriptor_map import MapSpace
from ebjax.train.losses import (
    choose_points,
    correlations,
    correspondences,
    cross_entropy,
    dense_loss,
    first_is_best,
    local_loss,
    without_common,
)


def test_cross_entropy_is_the_mean_of_both_ways():
    similarity = jax.random.normal(jax.random.key(0), (4, 4))
    every = jnp.ones((4, 4), bool)
    expected = -(jnp.diag(jax.nn.log_softmax(similarity, 0)) + jnp.diag(jax.nn.log_softmax(similarity, 1))).mean() / 2
    assert jnp.allclose(cross_entropy(similarity, every, every[0]), expected)


def test_cross_entropy_leaves_out_what_does_not_count():
    similarity = jax.random.normal(jax.random.key(0), (4, 4))
    valid = jnp.array([True, True, True, False])
    some = cross_entropy(similarity, jnp.ones((4, 4), bool), valid)
    assert jnp.allclose(some, cross_entropy(similarity[:3, :3], jnp.ones((3, 3), bool), valid[:3]))
    assert float(cross_entropy(similarity, jnp.zeros((4, 4), bool), valid)) == 0
    assert float(cross_entropy(similarity, jnp.ones((4, 4), bool), jnp.zeros(4, bool))) == 0


def test_correlations_are_those_of_the_search():
    key, other = jax.random.split(jax.random.key(1))
    maps = jax.random.normal(key, (3, 6, 8, 4)), jax.random.normal(other, (3, 6, 8, 4))
    mask = jnp.ones((6, 8))
    space = MapSpace(jnp.zeros((6, 8, 4)), jnp.eye(4), jnp.asarray(parity(4), jnp.float64), mask)
    found = jax.jit(correlations)(*maps, (mask, mask))
    references = jax.vmap(lambda values: spectrum(values, space))(maps[1])
    rows = [
        correlate(spectrum(values, space), references, overlap_weight(space), space, opposing=False)[0]
        for values in maps[0]
    ]
    np.testing.assert_allclose(found, jnp.stack(rows), atol=1e-9)


def test_what_all_views_share_is_taken_away():
    key, other = jax.random.split(jax.random.key(2))
    sign = jnp.asarray(parity(4), jnp.float64)
    first, second = jax.random.normal(key, (4, 5, 5, 4)), jax.random.normal(other, (4, 5, 5, 4))
    masks = jnp.ones((5, 5)).at[-1].set(0), jnp.ones((5, 5)).at[0].set(0)
    shared = jnp.array([1.0, -2.0, 3.0, 0.5])
    plain = without_common(first, second, masks, 2)
    ours, theirs = (jnp.broadcast_to(v, first.shape) for v in (shared, shared * sign))
    more = without_common(first + ours, second + theirs, masks, 2)
    for ours, theirs in zip(plain, more, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-12)


def test_points_lie_inside_and_find_their_places():
    grey = jax.random.uniform(jax.random.key(3), (2, 64, 64))
    seen = jnp.ones((64, 64)).at[:, :20].set(0)
    points = choose_points(grey, seen, 30, key=jax.random.key(4))
    assert bool((points[..., 0] >= 20).all() & (points >= 8).all() & (points < 56).all())
    moved = jnp.broadcast_to(jnp.array([[1.0, 0, 3], [0, 1, -2], [0, 0, 1]]), (2, 3, 3))
    there, valid = correspondences(points, moved, seen)
    np.testing.assert_allclose(there, np.asarray(points) + np.array([3.0, -2.0]))
    assert bool(valid.any()) and not bool(valid.all())


@pytest.fixture(scope="module")
def perfect():
    """The same random maps twice, with points."""
    maps = jax.random.normal(jax.random.key(5), (2, 16, 16, 32))
    points = jnp.stack(jnp.meshgrid(jnp.arange(10.0, 54, 8), jnp.arange(10.0, 54, 8)), -1).reshape(1, -1, 2)
    return maps, jnp.repeat(points, 2, axis=0)


@pytest.mark.slow
def test_maps_that_agree_cost_next_to_nothing(perfect):
    maps, points = perfect
    valid = jnp.ones(points.shape[:2], bool)
    scores = jnp.full(maps.shape[:3], 8.0)
    loss, score, right = local_loss(maps, maps, (scores, scores), (points, points), valid, 0.02)
    assert float(loss) < 0.01 and float(score) < 0.01 and float(right) == 1
    wrong, doubt, found = local_loss(maps, maps[::-1], (scores, scores), (points, points), valid, 0.02)
    assert float(wrong) > 5 and float(doubt) > 4 and float(found) < 0.3
    coarse = maps[:, ::2, ::2]
    assert float(dense_loss(coarse, coarse, (points, points), valid, 0.02)) < 0.01


def test_recall_counts_rows_whose_best_is_their_own():
    assert float(first_is_best(jnp.array([[2.0, 1], [3, 1]]))) == 0.5
