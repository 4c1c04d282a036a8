"""Rows without a pose, quaternions off length 1, matrices that are none."""

import numpy as np
import pytest

from ebjax.io.pose_table.rows import lines_listed

TUM = "t x y z qx qy qz qw"
SEVEN = "{0} {0} {0} {0} {0} {0} {0}"


def lost(drive, rows, pose, separator=" ", columns=TUM, header=""):
    lines = drive.text(columns, separator).splitlines()
    for k in rows:
        lines[k] = lines[k].split(separator)[0] + separator + pose
    return "\n".join([header, *lines] if header else lines)


WORDS = ["nan", "NaN", "NAN", "-nan", "inf", "-Inf", "1.#QNAN", "-nan(ind)", "null", "None", "N/A"]
LOST = {word: SEVEN.format(word) for word in WORDS} | {
    "null quaternion": "1 2 3 0 0 0 0",
    "all zeros": "0.0 0.0 0.0 0.0 0.0 0.0 0.0",
    "one part": "1 2 nan 0 0 0 1",
}


@pytest.mark.parametrize("name", LOST)
def test_rows_without_a_pose_are_left_out_and_counted(drive, reading, name):
    found = reading(lost(drive, [4, 5, 6, 19], LOST[name]))
    kept = np.delete(np.arange(80), [4, 5, 6, 19])
    np.testing.assert_array_equal(found.timestamps, drive.times[kept])
    np.testing.assert_allclose(found.poses[:, :3, 3], drive.positions[kept], atol=1e-8)
    assert found.notes == (
        f"{found.path}: 4 of 80 rows hold no pose (NaN, empty, or a null quaternion) and are left out: lines 5-7, 20 "
        "(1403636581.750 to 1403636589.250 s)",
    )


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("header", ["", "t;x;y;z;qx;qy;qz;qw"])
def test_empty_fields(drive, reading, separator, header):
    found = reading(lost(drive, [2, 79], separator.join([""] * 7), separator, header=header))
    assert len(found.poses) == 78 and "2 of 80 rows hold no pose" in found.notes[0]


def test_null_matrices_and_rows_without_times_keep_their_numbers(drive, reading):
    lines = drive.text(" ".join(f"m{k}" for k in range(12))).splitlines()
    lines[1], lines[3] = " ".join(["0"] * 12), " ".join(["nan"] * 12)
    found = reading("\n".join(lines))
    np.testing.assert_array_equal(found.timestamps[:4], [0, 2, 4, 5])
    assert "2 of 80 rows hold no pose" in found.notes[0] and "lines 2, 4" in found.notes[0]


def test_a_file_of_lost_rows_is_refused(reading):
    with pytest.raises(ValueError, match="none of its 2 rows holds a pose"):
        reading("1 nan nan nan nan nan nan nan\n2 0 0 0 0 0 0 0\n")


@pytest.mark.parametrize("factor, words", [(1.04, "4.0%"), (0.97, "3.0%"), (1.0005, None)])
def test_quaternions_slightly_off_are_normalised(drive, reading, factor, words):
    rows = np.concatenate([drive.times[:, None], drive.positions, factor * drive.rotations.as_quat()], axis=1)
    found = reading("\n".join(" ".join(f"{v:.9f}" for v in row) for row in rows))
    drive.check(found)
    assert [f"up to {words} off length 1 are normalised" in note for note in found.notes] == [True] * bool(words)


@pytest.mark.parametrize(
    "text, words",
    [
        (
            "1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1.06\n",
            r"line 2: the quaternion's length is 1\.06.* its order is qx qy qz qw",
        ),
        ("# timestamp tx ty tz qx qy qz qw\n1 0 0 0 0 0 0 0.9\n", "line 2: the quaternion's length is .* header says"),
        ("1 0 0 0 0 0 0 1\n2 0 x 0 0 0 0 1\n", "line 2: 'x' is not a number"),
        ("1 0 0 0 0 0 0 1\n2 1e10 0 0 0 0 0 1\n", r"line 2: a number over 1e\+09 is no part of a pose"),
        ("1 0 0 0 0 0 0 1\n2 1e999 0 0 0 0 0 1\n", "line 2: '1e999' is not a number"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n2 0 0 0 0 1 0 0 0 0 1 0\n", "line 2: not a pose"),
        ("-1 0 0 0 0 1 0 0 0 0 1 0\n", "line 1: not a pose.*reflection"),
        ("1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 2\n", "line 1: not a pose.*last row"),
    ],
)
def test_what_is_no_pose_is_refused(reading, text, words):
    with pytest.raises(ValueError, match=f"poses.txt {words}"):
        reading(text)


def test_lines_are_listed_as_ranges():
    assert lines_listed([3]) == "line 3"
    assert lines_listed([5, 6, 7, 20]) == "lines 5-7, 20"
    assert lines_listed(list(range(1, 20, 2))) == "lines 1, 3, 5, 7 and 6 more places"
