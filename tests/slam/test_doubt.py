"""When a path is in doubt, what ends the doubt, and when it is given up."""

import numpy as np
import pytest

from ebjax.odometry.steps import Steps
from ebjax.slam.doubt import PATIENCE, Doubt

EXTENT_M = 1.5


def steps(*ends, used=True, kind="floor"):
    """Measured steps between rows (later, earlier)."""
    i, j = np.array(ends, int).reshape(-1, 2).T
    count = len(i)
    reason = np.full(count, "used" if used else "few matches", object)
    numbers, poses = np.full(count, 50), np.zeros((count, 3))
    return Steps(i, j, np.full(count, kind, object), numbers, numbers, poses, np.zeros((count, 3, 3)), reason)


def broken(doubt, row, last_m=0.2, seconds=0.5, count=8):
    ways = np.full(count, 0.2)
    ways[-1] = last_m
    times = np.full(count, 0.5)
    times[-1] = seconds
    return doubt.broken(row, ways, times)


@pytest.mark.parametrize("kind", ["floor", "depth", "image", "rotation"])
def test_a_path_that_is_measured_is_not_in_doubt(kind):
    doubt = Doubt(EXTENT_M)
    for row in range(1, 6):
        doubt.go_on(row, steps((row, row - 1), kind=kind), False)
        assert not doubt and broken(doubt, row) is None


@pytest.mark.parametrize("missing", [steps(), steps((5, 4), used=False)])
def test_it_is_given_up_where_nothing_shows_that_it_held(missing):
    doubt = Doubt(EXTENT_M)
    doubt.go_on(5, missing, False)
    assert doubt and broken(doubt, 5) is None
    for row in range(6, 5 + PATIENCE):
        doubt.go_on(row, steps((row, row - 1)), False)
    assert broken(doubt, 5 + PATIENCE - 1) == 5
    doubt.end()
    assert not doubt


def test_a_blurred_view_is_reached_across():
    doubt = Doubt(EXTENT_M)
    doubt.go_on(5, steps(), False)
    doubt.go_on(6, steps((6, 4)), False)
    assert not doubt


def test_what_reaches_into_the_gap_only_does_not_end_it():
    doubt = Doubt(EXTENT_M)
    doubt.go_on(5, steps(), False)
    doubt.go_on(6, steps((6, 5)), False)
    doubt.go_on(7, steps((7, 6), (7, 5)), False)
    assert broken(doubt, 7) == 5


def test_the_path_begins_anew_behind_the_last_gap():
    doubt = Doubt(EXTENT_M)
    for row in (5, 6, 7):
        doubt.go_on(row, steps(), False)
    assert broken(doubt, 7) == 7


def test_a_closure_that_fits_ends_it():
    doubt = Doubt(EXTENT_M)
    doubt.go_on(5, steps(), False)
    doubt.go_on(6, steps((6, 5)), True)
    assert not doubt


@pytest.mark.parametrize(
    ("last_m", "seconds", "row"), [(6.0, 0.5, 5), (1.4, 0.5, None), (2.4, 0.5, 5), (6.0, 5.0, None)]
)
@pytest.mark.parametrize("seen", [steps(), steps((5, 4), kind="rotation")])
def test_a_leap_that_no_robot_makes_is_a_break_at_once(seen, last_m, seconds, row):
    doubt = Doubt(EXTENT_M)
    doubt.go_on(5, seen, False)
    assert broken(doubt, 5, last_m, seconds) == row


def test_a_first_step_says_what_a_view_says():
    doubt = Doubt(EXTENT_M)
    doubt.go_on(1, steps(), False)
    assert broken(doubt, 1, 0.3, count=1) is None and broken(doubt, 1, 9.0, count=1) == 1


def test_a_leap_that_the_floor_shows_is_none():
    doubt = Doubt(EXTENT_M)
    doubt.go_on(5, steps((5, 4)), False)
    assert broken(doubt, 5, 6.0) is None
