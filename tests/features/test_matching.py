import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.features.matching import Features, mutual_nearest


def features(descriptors, valid=None):
    valid = np.ones(len(descriptors), bool) if valid is None else valid
    return Features(jnp.zeros((len(descriptors), 2)), jnp.asarray(descriptors), jnp.asarray(valid))


@pytest.fixture
def pair():
    random = np.random.default_rng(0)
    one = random.standard_normal((60, 16))
    two = np.concatenate([one[:40] + 0.3 * random.standard_normal((40, 16)), random.standard_normal((30, 16))])
    unit = lambda d: d / np.linalg.norm(d, axis=1, keepdims=True)  # noqa: E731
    order = random.permutation(70)
    return unit(one), unit(two[order]), random.random(60) > 0.1, random.random(70) > 0.1


def by_loop(one, two, valid_one, valid_two, max_ratio):
    found = {}
    for i in np.flatnonzero(valid_one):
        distance = [(np.linalg.norm(one[i] - two[j]), j) for j in np.flatnonzero(valid_two)]
        (first, j), (second, _) = sorted(distance)[:2]
        back = min((np.linalg.norm(one[k] - two[j]), k) for k in np.flatnonzero(valid_one))[1]
        if back == i and first / second <= max_ratio:
            found[(int(i), int(j))] = first / second
    return found


@pytest.mark.parametrize("max_ratio", [1.0, 0.9, 0.7])
def test_matches_are_those_of_a_plain_loop_best_first(pair, max_ratio):
    one, two, valid_one, valid_two = pair
    found = mutual_nearest(features(one, valid_one), features(two, valid_two), max_ratio=max_ratio)
    rows = np.flatnonzero(found.valid)
    expected = by_loop(*pair, max_ratio)
    ours = list(zip(np.asarray(found.query)[rows].tolist(), np.asarray(found.reference)[rows].tolist(), strict=True))
    assert set(ours) == set(expected) and len(ours) == len(expected)
    np.testing.assert_allclose(np.asarray(found.ratio)[rows], [expected[m] for m in ours], atol=1e-6)
    assert (np.diff(np.asarray(found.ratio)[rows]) >= 0).all()


def test_matches_are_those_of_opencvs_cross_check(pair):
    one, two = pair[0].astype(np.float32), pair[1].astype(np.float32)
    found = mutual_nearest(features(one), features(two))
    theirs = {(m.queryIdx, m.trainIdx) for m in cv2.BFMatcher(cv2.NORM_L2, crossCheck=True).match(one, two)}
    rows = np.flatnonzero(found.valid)
    assert set(zip(np.asarray(found.query)[rows], np.asarray(found.reference)[rows], strict=True)) == theirs


def test_keeps_the_most_distinctive(pair):
    every = mutual_nearest(features(pair[0]), features(pair[1]))
    few = mutual_nearest(features(pair[0]), features(pair[1]), keep=7)
    assert few.valid.shape == (7,) and few.valid.all()
    np.testing.assert_array_equal(few.query, every.query[:7])


def test_nothing_valid_gives_nothing_and_vmap_is_a_loop(pair):
    one, two, valid_one, _ = pair
    assert not mutual_nearest(features(one, np.zeros(60, bool)), features(two)).valid.any()
    stack = lambda *trees: jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)  # noqa: E731
    queries = [features(one), features(one, valid_one)]
    many = jax.vmap(lambda q: mutual_nearest(q, features(two)))(stack(*queries))
    for k, query in enumerate(queries):
        np.testing.assert_array_equal(many.query[k], mutual_nearest(query, features(two)).query)
