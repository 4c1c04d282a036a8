import numpy as np
import pytest

from ebjax.io.clocks import UNITS, finer_unit, in_seconds, overlap, ratio_unit, seconds_text, time_range, unix_unit

UNIX = 1403636579.75


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("spacing", [0.001, 0.05, 3.0])
def test_dates_tell_their_unit(unit, spacing):
    times = UNIX + np.arange(100) * spacing
    assert unix_unit(times) is None and finer_unit(times, times) is None
    assert unix_unit(times * UNITS[unit]) == unit
    found, said = in_seconds(times * UNITS[unit])
    assert said == unit and np.abs(found - times).max() < 1e-6


@pytest.mark.parametrize("start", [0.0, 5.0, 1500.0, 3e5])
def test_clocks_that_count_from_a_start_are_no_dates(start):
    seconds = start + np.arange(400) * 0.05
    for per_second in (1.0, *UNITS.values()):
        assert unix_unit(seconds * per_second) is None
        # Uptime in nanoseconds may read like a date in milliseconds, and 1 to 4 s of it like a date in seconds.
        assert unix_unit((seconds + 1500) * per_second) is None


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("start", [0.0, 40.0, 3e5, UNIX])
@pytest.mark.parametrize("part", [slice(None), slice(50, 250), slice(None, None, 10)])
def test_a_finer_unit_is_recognised_beside_seconds(unit, start, part):
    seconds = start + np.arange(400) * 0.05
    assert finer_unit(seconds[part] * UNITS[unit], seconds + 0.01) == unit
    assert finer_unit(seconds, seconds[part] * UNITS[unit]) is None
    assert finer_unit(seconds[part], seconds) is None


def test_other_rates_and_lengths_are_not_taken_for_units():
    day, minute = np.arange(0, 86400.0), np.arange(0, 60, 0.1)
    for one, other in ((day, minute), (minute, day), (minute + 1e6, minute), (UNIX + day, UNIX + minute)):
        assert finer_unit(one, other) is None
    keyframes, motion_capture = np.arange(0, 60, 1.0), np.arange(0, 60, 0.001)
    assert finer_unit(keyframes, motion_capture) is None and finer_unit(motion_capture, keyframes) is None
    assert finer_unit(np.array([5.0]), minute) is None and finer_unit(minute, np.array([5.0])) is None
    assert ratio_unit(np.zeros(3), minute) is None


@pytest.mark.parametrize("unit", UNITS)
def test_a_unit_beside_another_clock(unit):
    seconds = np.arange(400) * 0.05
    assert finer_unit(seconds * UNITS[unit], seconds + UNIX) is None
    assert ratio_unit(seconds * UNITS[unit], seconds + UNIX) == unit
    assert ratio_unit(seconds, seconds * UNITS[unit]) is None


def test_overlap_is_a_share_of_the_shorter():
    a = np.array([0.0, 10.0])
    assert overlap(a, np.array([5.0, 7.0])) == 1 and overlap(a, np.array([8.0, 12.0])) == 0.5
    assert overlap(a, np.array([10.5, 12.0])) == 0 and overlap(a, np.array([3.0])) == 1 and overlap(a, a + 11) == 0


def test_ranges_in_words():
    assert time_range(np.array([0.0, 20.0])) == "0.000 to 20.000 s (20 s long)"
    assert time_range(UNIX + np.array([0, 7200.0])).endswith("(2014-06-24 19:02:59 UTC, 120 min long)")
    assert time_range(np.array([0.0, 2e10])).endswith("(2.31e+05 days long)")
    assert seconds_text(UNIX) == "1403636579.75" and seconds_text(-0.0) == "0" and seconds_text(-12.5) == "-12.5"
