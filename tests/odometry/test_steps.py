import dataclasses

import numpy as np
import pytest

from ebjax.odometry.steps import MAX_SIGMA_DEG, MAX_SIGMA_M, MIN_INLIERS, MIN_RATIO, USED, Steps, joined, judged

CERTAIN = np.diag([1e-6, 1e-6, 1e-8])


def table(i, j, reason=USED, kind="floor"):
    count = len(i)
    full = np.full(count, 50)
    motion = np.stack([np.arange(count), np.arange(count), np.zeros(count)], 1).astype(float)
    kinds, reasons = np.full(count, kind, object), np.full(count, reason, object)
    return Steps(
        np.array(i, int), np.array(j, int), kinds, full, full, motion, np.tile(CERTAIN, (count, 1, 1)), reasons
    )


def judge(inliers=50, matches=60, motion=(0.2, 0.0, 0.0), sigma=(0.002, 0.002, 0.001)):
    return judged(
        np.array([1]),
        np.array([0]),
        np.array(["floor"], object),
        np.array([inliers]),
        np.array([matches]),
        np.array([motion], float),
        np.diag(np.square(sigma))[None],
    ).reason[0]


def test_a_step_with_many_matches_and_small_sigmas_is_used():
    assert judge() == USED
    assert judge(MIN_INLIERS, round(MIN_INLIERS / MIN_RATIO)) == USED
    assert judge(sigma=(0.99 * MAX_SIGMA_M, 0.99 * MAX_SIGMA_M, np.radians(0.99 * MAX_SIGMA_DEG))) == USED


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"inliers": MIN_INLIERS - 1, "matches": MIN_INLIERS - 1}, "few matches"),
        ({"inliers": 0, "matches": 0}, "few matches"),
        ({"inliers": 30, "matches": 100}, "few of the matches agree"),
        ({"inliers": 10, "matches": 100}, "few matches"),
        ({"sigma": (1.01 * MAX_SIGMA_M, 0.001, 0.001)}, "uncertain"),
        ({"sigma": (0.001, 1.01 * MAX_SIGMA_M, 0.001)}, "uncertain"),
        ({"sigma": (0.001, 0.001, np.radians(1.01 * MAX_SIGMA_DEG))}, "uncertain"),
        ({"motion": (np.nan, 0.0, 0.0)}, "few matches"),
        ({"motion": (0.0, np.inf, 0.0)}, "few matches"),
        ({"sigma": (np.nan, 0.001, 0.001)}, "few matches"),
        ({"sigma": (0.001, 0.001, np.inf)}, "few matches"),
    ],
)
def test_why_a_step_is_not_used(changed, reason):
    assert judge(**changed) == reason


def test_rows_are_judged_one_by_one():
    count = 4
    covariance = np.tile(CERTAIN, (count, 1, 1))
    covariance[2, 2, 2] = 1.0
    found = judged(
        np.arange(1, 5),
        np.arange(4),
        np.full(count, "floor", object),
        np.array([50, 5, 50, 25]),
        np.array([60, 6, 60, 80]),
        np.zeros((count, 3)),
        covariance,
    )
    assert list(found.reason) == [USED, "few matches", "uncertain", "few of the matches agree"]
    np.testing.assert_array_equal(found.used, [True, False, False, False])


def test_no_rows():
    none = table([], [])
    assert len(joined([none, none]).i) == len(none.consecutive()) == len(none.share()) == 0
    found = judged(none.i, none.j, none.kind, none.inliers, none.matches, none.i_from_j, none.covariance)
    assert len(found.reason) == 0 and not none.refuse(np.zeros(0, bool), "why").used.any()


def test_refuse_keeps_the_first_reason_and_the_table_itself():
    steps = table([1, 2, 3, 4], [0, 1, 2, 3])
    steps.reason[1] = "few matches"
    refused = steps.refuse(np.array([True, True, False, False]), "because")
    assert list(refused.reason) == ["because", "few matches", USED, USED]
    assert list(steps.reason) == [USED, "few matches", USED, USED]
    assert list(refused.refuse(np.ones(4, bool), "later").reason) == ["because", "few matches", "later", "later"]
    for field in dataclasses.fields(Steps)[:-1]:
        assert getattr(refused, field.name) is getattr(steps, field.name)


def test_consecutive_are_used_steps_from_the_keyframe_before():
    steps = table([1, 2, 2, 3, 4], [0, 1, 0, 2, 2]).refuse(np.array([False, True, False, False, False]), "because")
    np.testing.assert_array_equal(steps.consecutive(), [0, 3])


def test_a_chain_counts_once():
    chain = table(np.arange(1, 6), np.arange(5))
    np.testing.assert_array_equal(chain.share(), 1)


def test_views_with_more_steps_count_less_in_each():
    later = np.concatenate([np.arange(gap, 12) for gap in (1, 2, 4)])
    earlier = np.concatenate([np.arange(12 - gap) for gap in (1, 2, 4)])
    steps = table(later, earlier)
    degree = np.array([np.sum((later == k) | (earlier == k)) for k in range(12)])
    np.testing.assert_allclose(steps.share(), np.maximum((degree[later] + degree[earlier]) / 4, 1))
    assert steps.share()[(later == 6) & (earlier == 5)] == 3
    # All that a view in the middle says weighs like the two steps of a chain.
    assert np.sum(1 / steps.share()[(later == 5) | (earlier == 5)]) == pytest.approx(2, abs=0.3)


def test_refused_steps_do_not_share():
    later, earlier = np.array([1, 2, 2, 3, 3]), np.array([0, 1, 0, 2, 1])
    steps = table(later, earlier)
    assert steps.share().max() > 1
    np.testing.assert_array_equal(steps.refuse(later - earlier > 1, "because").share(), 1)


def test_joined_is_ordered_by_the_later_keyframe_then_the_earlier():
    floor = table([1, 3, 3, 5], [0, 2, 1, 4])
    image = table([2, 4], [1, 3], "uncertain", "image")
    found = joined([image, floor])
    np.testing.assert_array_equal(found.i, [1, 2, 3, 3, 4, 5])
    np.testing.assert_array_equal(found.j, [0, 1, 1, 2, 3, 4])
    assert list(found.kind) == ["floor", "image", "floor", "floor", "image", "floor"]
    np.testing.assert_array_equal(found.used, [True, False, True, True, False, True])
    np.testing.assert_array_equal(found.i_from_j[:, 0], [0, 0, 2, 1, 1, 3])
    assert found.covariance.shape == (6, 3, 3)
