"""What separates columns, decimal commas, quotes, comments and trailing separators."""

import gzip
import re

import numpy as np
import pytest

from ebjax.io.pose_table.fields import read_table

TUM = "t x y z qx qy qz qw"


def german(text):
    return text.replace(".", ",")


@pytest.mark.parametrize("separator", [" ", "  ", "\t", ", ", ",", ";", " ; ", " , "])
def test_separators(drive, reading, separator):
    drive.check(reading(drive.text(TUM, separator)))


@pytest.mark.parametrize("separator", [" ", "   ", "\t", ";", "; ", ", "])
@pytest.mark.parametrize("header", ["", "# timestamp tx ty tz qx qy qz qw"])
def test_decimal_commas(drive, reading, separator, header):
    found = reading(german(drive.text(TUM, separator, header)))
    drive.check(found)
    assert len(found.notes) == 1 and "poses.txt: commas are decimal, read as points" in found.notes[0]


def test_decimal_commas_in_quotes_and_among_whole_numbers(reading):
    found = reading('"1403636579,75","1,5","2","0","0","0","0","1"\n"1403636580,75","2,5","2","0","0","0","0","1"\n')
    np.testing.assert_array_equal(found.timestamps, [1403636579.75, 1403636580.75])
    np.testing.assert_array_equal(found.poses[:, 0, 3], [1.5, 2.5])
    found = reading("1,5;2,5;90\n2;3;-1,8E+02\n")
    np.testing.assert_array_equal(found.poses[:, :2, 3], [[1.5, 2.5], [2, 3]])
    np.testing.assert_allclose(found.poses[:, 0, 0], [0, -1], atol=1e-12)


def test_whole_numbers_between_commas_are_no_decimals(reading):
    np.testing.assert_array_equal(reading("5,1,2,3,0,0,0,1\n6,1,2,3,0,0,0,1\n").timestamps, [5, 6])
    np.testing.assert_array_equal(reading("5, 1, 2, 3, 0, 0, 0, 1\n").poses[0, :3, 3], [1, 2, 3])
    np.testing.assert_array_equal(reading("5 1,0 2,5 3 0 0 0 1\n").poses[0, :3, 3], [1, 2.5, 3])


@pytest.mark.parametrize("columns", ["x y yaw", "t x y yaw", TUM, "m0 m1 m2 m3 m4 m5 m6 m7 m8 m9 m10 m11"])
def test_commas_that_are_decimal_and_separate_are_refused_and_the_remedy_works(drive, reading, columns):
    with pytest.raises(ValueError, match=r"line 1: commas are decimal and stand between the columns.* semicolons"):
        reading(german(drive.text(columns, ",")))
    assert len(reading(german(drive.text(columns, ";"))).poses) == 80


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("packed", [False, True])
def test_bytes(drive, reading, end, encoding, packed):
    content = drive.text(TUM, " ", "# timestamp tx ty tz qx qy qz qw").replace("\n", end).encode(encoding)
    found = reading(gzip.compress(content) if packed else content)
    drive.check(found)
    assert found.notes == ()


@pytest.mark.parametrize("separator", [",", ";", " "])
def test_trailing_separators(drive, reading, separator):
    text = drive.text(TUM, separator, "timestamp,tx,ty,tz,qx,qy,qz,qw")
    drive.check(reading(re.sub("(?<=.)$", separator, text, flags=re.MULTILINE)))
    drive.check(reading(text.replace("\n", separator + "\n").replace("qw" + separator, "qw", 1)))
    drive.check(reading(drive.text(TUM, separator).replace("\n", separator + "\n")))


def test_an_empty_last_column_with_a_name_stays_a_column(drive, reading):
    drive.check(
        reading(drive.text(TUM, ",", "t,x,y,z,qx,qy,qz,qw,comment").replace("\n", ",\n").replace("comment,", "comment"))
    )


def test_comments_and_blank_lines(drive, reading):
    lines = drive.text(TUM).splitlines()
    lines[3:3] = ["", "# in between", "   ", "% matlab", "// C"]
    lines[-1] += "  # the last"
    drive.check(reading("\n\n".join(lines)))


def test_numbers_of_lines_are_those_of_the_file(tmp_path):
    (tmp_path / "a.csv").write_bytes(b"\xef\xbb\xbfx,y,yaw\r\n\r\n# c\r\n1,2,3\r\n4,5,6\r\n")
    table = read_table(tmp_path / "a.csv")
    assert [number for number, _ in table.rows] == [4, 5] and table.names == (1, "x,y,yaw")


@pytest.mark.parametrize(
    "text, words",
    [
        ("", "no poses"),
        ("# only a comment\n", "no poses"),
        ("timestamp,x,y,yaw\n", "no poses"),
        ("1 2 3\n1 2\n", "line 2: 2 columns, but line 1 has 3; correct or remove the line"),
        ("{\n'a': [\n1 2 3\n", "line 2: \"'a':.* is no row of numbers"),
        ("0 1 2 3 0 0 0 1_0\n", "line 1: '1_0' is not a number"),
        ("1.403.636.579,75;0;0;0;0;0;0;1\n", "line 1: '1.403.636.579,75' is not a number"),
    ],
)
def test_what_is_no_table_is_refused(reading, text, words):
    with pytest.raises(ValueError, match=f"poses.txt.*{words}"):
        reading(text)
