"""Recall and precision on cases small enough to count by hand."""

import numpy as np
import pytest

from ebjax.places.recall import ROWS, facing_pairs, judged_claims, precision_100, recall_at, recall_at_1


def test_facing_pairs_look_at_the_same_floor_from_the_opposite_side():
    """The view lies 1 m ahead: a robot at x = 2 that looks back sees the floor of a robot at x = 0 that looks ahead."""
    poses = np.array([[0, 0, 0], [2, 0, np.pi], [0, 0, np.pi], [2, 0, np.radians(150)], [np.nan] * 3, [2, 0.3, -np.pi]])
    pairs = facing_pairs(poses, np.array([1.0, 0.0]), 0.5)
    expected = np.zeros((6, 6), bool)
    expected[1, 0] = expected[5, 0] = True
    np.testing.assert_array_equal(pairs, expected)


def test_a_claim_is_right_where_the_direction_is_too():
    """Three passes over one place: ahead, back, ahead; the views of the last two are queries."""
    poses = np.array([[0, 0, 0], [0, 0, np.pi], [0.1, 0, 0], [5, 0, 0]], float)
    first, ahead = np.array([-1, 0, 0, 0]), np.zeros(4, bool)
    right, asked = judged_claims(poses, np.zeros(2), 0.5, first, ahead)
    assert asked.tolist() == [False, True, True, False] and right.tolist() == [False, False, True, False]
    right, _ = judged_claims(poses, np.zeros(2), 0.5, first, ~ahead)
    assert right.tolist() == [False, True, False, False]


def test_queries_are_the_same_block_by_block():
    rng = np.random.default_rng(0)
    poses = np.stack([rng.uniform(0, 9, 3 * ROWS // 2), *rng.uniform(0, 3, (2, 3 * ROWS // 2))], -1)
    _, asked = judged_claims(poses, np.array([1.0, 0.0]), 0.3, np.zeros(len(poses), int), np.zeros(len(poses), bool))
    np.testing.assert_array_equal(asked, facing_pairs(poses, np.array([1.0, 0.0]), 0.3).any(1))
    assert judged_claims(np.zeros((0, 3)), np.zeros(2), 1.0, np.zeros(0, int), np.zeros(0, bool))[1].shape == (0,)


def test_facing_angle_is_25_degrees():
    for off, faces in ((24.0, True), (26.0, False)):
        poses = np.array([[0, 0, 0], [0, 0, np.radians(180 - off)]])
        assert facing_pairs(poses, np.zeros(2), 0.1)[1, 0] == faces


def test_recall_at_1_counts_queries_with_a_true_view_only():
    pairs = np.zeros((5, 5), bool)
    pairs[2, 1] = pairs[3, 0] = pairs[4, 0] = True
    first = np.array([-1, 0, 1, 0, -1])
    assert recall_at_1(first, np.array([False, True, True, True, True]), pairs) == (2 / 3, 3)
    assert recall_at_1(first, np.array([False, True, True, False, True]), pairs) == (1 / 3, 3)
    assert recall_at_1(first, np.ones(5, bool), np.zeros((5, 5), bool)) == (None, 0)


def test_no_candidate_is_not_the_first_view():
    pairs = np.zeros((2, 2), bool)
    pairs[1, 0] = True
    assert recall_at_1(np.array([-1, -1]), np.ones(2, bool), pairs) == (0.0, 1)


@pytest.mark.parametrize(
    "score, right, expected",
    [
        ([0.9, 0.2, 0.5, 0.4], [True, True, True, False], 0.5),
        ([0.9, 0.2, 0.5, 0.4], [False, True, True, True], 0.0),
        ([0.9, 0.2], [True, True], 1.0),
        ([0.5, 0.9, -np.inf], [True, True, False], 2 / 3),
        ([], [], 0.0),
    ],
)
def test_precision_100(score, right, expected):
    assert precision_100(np.array(score, float), np.array(right, bool)) == pytest.approx(expected)


def test_recall_at_k():
    ranked = [[3, 1, 2], [0], [], [5, 4]]
    accepted = {0: [2], 1: [0, 9], 2: [1], 3: []}
    assert recall_at(ranked, accepted, 1) == (1 / 3, 3)
    assert recall_at(ranked, accepted, 3) == (2 / 3, 3)
    assert recall_at(ranked, {}, 1) == (None, 0)
