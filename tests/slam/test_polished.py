"""What becomes of a run whose floor mirrors the room; the whole of it is in test_medians.py."""

import numpy as np
import pytest

from ebjax.geometry.planar import between, chained
from ebjax.odometry.wheels import Systematic
from ebjax.slam.polished import best_of, turning_as_measured


@pytest.mark.parametrize(
    "views, medians, wrong, best",
    [
        (0, 28, 3, "medians"),
        (0, 5, 5, "wheels"),
        (0, 5, 8, "wheels"),
        (0, 0, 0, "wheels"),
        (6, 5, 0, "views"),
        (6, 6, 0, "views"),
        (6, 7, 0, "medians"),
    ],
)
def test_medians_have_more_closures_than_views_and_than_contradict_them(views, medians, wrong, best):
    assert best_of(views, medians, wrong) == best


def test_only_the_turns_are_put_right():
    rng = np.random.default_rng(0)
    true = chained(np.column_stack([rng.uniform(0.1, 0.3, 40), np.zeros(40), rng.normal(0, 0.1, 40)]))
    steps = between(true[:-1], true[1:])
    length, turn = np.linalg.norm(steps[:, :2], axis=1), steps[:, 2]
    counted = (turn - np.radians(2.0) * length) / 1.25
    odom = chained(np.column_stack([length * np.cos(counted / 2), length * np.sin(counted / 2), counted]))
    wrong = Systematic(scale=0.9, gain=1.25, bend_deg_per_m=2.0)
    found = turning_as_measured(odom, np.arange(len(odom), dtype=float), wrong)
    np.testing.assert_allclose(between(found[:-1], found[1:])[:, 2], turn, atol=2e-4)
    np.testing.assert_allclose(np.linalg.norm(np.diff(found[:, :2], axis=0), axis=1), length, rtol=1e-9)
    np.testing.assert_array_equal(turning_as_measured(odom, np.arange(len(odom), dtype=float), None), odom)
