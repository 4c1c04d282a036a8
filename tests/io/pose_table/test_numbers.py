"""Times in every unit, rounded once."""

from fractions import Fraction

import numpy as np
import pytest

STAMPS_NS = [1403636579750000128, 1403636580249999872, 1403636580750000128]
REST = " 0 0 0 0 0 0 1\n"


def exact(stamps_ns):
    return [float(Fraction(stamp) / 10**9) for stamp in stamps_ns]


@pytest.mark.parametrize("form", ["{}", "{}.000000", "{}.0"])
@pytest.mark.parametrize("header", ["", "# timestamp_ns x y z qx qy qz qw\n", "# timestamp [ns] x y z qx qy qz qw\n"])
def test_nanoseconds_are_rounded_once(reading, form, header):
    found = reading(header + "".join(form.format(stamp) + REST for stamp in STAMPS_NS))
    assert list(found.timestamps) == exact(STAMPS_NS)
    how = "header" if header else "by their size"
    assert found.notes == (f"{found.path}: stamps are nanoseconds ({how}), read as seconds",)


def test_nanoseconds_in_scientific_notation(reading):
    found = reading("1.40363657975e+18" + REST + "1.40363658025E18" + REST)
    np.testing.assert_array_equal(found.timestamps, [1403636579.75, 1403636580.25])


def test_seconds_and_nanoseconds_are_rounded_once(reading):
    rows = "".join(f"{stamp // 10**9},{stamp % 10**9},0,0,0\n" for stamp in STAMPS_NS)
    assert list(reading("sec,nanosec,x,y,yaw\n" + rows).timestamps) == exact(STAMPS_NS)


@pytest.mark.parametrize("unit, factor", [("us", 1e6), ("ms", 1e3), ("s", 1.0), ("ns", 1e9)])
@pytest.mark.parametrize("start", [1403636579.75, 12.5])
def test_units_of_a_header(reading, unit, factor, start):
    times = start + 0.5 * np.arange(5)
    rows = "".join(f"{t * factor:.0f}" + REST if unit != "s" else f"{t}{REST}" for t in times)
    for name in (f"timestamp_{unit}", f"timestamp [{unit}]", f"t({unit})", f"time_{unit}"):
        found = reading(f"# {name} tx ty tz qx qy qz qw\n{rows}")
        np.testing.assert_allclose(found.timestamps, times, rtol=0, atol=1e-6)
        assert len(found.notes) == (unit != "s")


@pytest.mark.parametrize("factor, name", [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")])
def test_units_by_the_date(reading, factor, name):
    times = 1403636579.75 + 0.05 * np.arange(20)
    found = reading("".join(f"{t * factor:.0f}" + REST for t in times))
    np.testing.assert_allclose(found.timestamps, times, rtol=0, atol=1e-3)
    assert f"stamps are {name} (by their size)" in found.notes[0]


def test_nanoseconds_since_the_start_of_the_machine(reading):
    found = reading("".join(f"{2 * 10**14 + k * 50_000_000}" + REST for k in range(5)))
    np.testing.assert_allclose(found.timestamps, 2e5 + 0.05 * np.arange(5))


@pytest.mark.parametrize("start, step", [(0, 50_000_000), (10**10, 50_000_000), (0, 50_000)])
def test_a_unit_that_cannot_be_known_is_said_and_the_remedy_works(reading, start, step):
    rows = "".join(f"{start + k * step}" + REST for k in range(5))
    found = reading(rows)
    np.testing.assert_array_equal(found.timestamps, start + step * np.arange(5))
    assert "are no seconds, and their unit is not known; name it in the first line" in found.notes[0]
    found = reading("# timestamp_ns tx ty tz qx qy qz qw\n" + rows)
    np.testing.assert_allclose(found.timestamps, (start + step * np.arange(5)) * 1e-9)
    assert reading("# timestamp_s tx ty tz qx qy qz qw\n" + rows).notes == ()


def test_seconds_that_cannot_be_are_read_by_their_size(reading):
    found = reading("# timestamp [s] tx ty tz qx qy qz qw\n" + "".join(f"{stamp}" + REST for stamp in STAMPS_NS))
    assert list(found.timestamps) == exact(STAMPS_NS) and "nanoseconds (by their size)" in found.notes[0]


def test_frame_numbers_as_times_pass(reading):
    assert reading("".join(f"{k}" + REST for k in range(5))).notes == ()


def test_a_pose_needs_a_finite_time(reading):
    with pytest.raises(ValueError, match="line 2: 'nan' is not a finite time"):
        reading("1" + REST + "nan" + REST)
