"""Columns without a header."""

import re

import pytest

LAYOUTS = {
    "TUM": "t x y z qx qy qz qw",
    "TUM, w first": "t x y z qw qx qy qz",
    "RTAB-Map": "t x y z qx qy qz qw n",
    "number first": "n t x y z qx qy qz qw",
    "number first, w first": "n t x y z qw qx qy qz",
    "EuRoC": "ns x y z qw qx qy qz 0 0 0 0 0 0 0 0 0",
    "VINS": "ns x y z qw qx qy qz 0 0 0",
    "TartanAir": "x y z qx qy qz qw",
    "KITTI": "m0 m1 m2 m3 m4 m5 m6 m7 m8 m9 m10 m11",
    "number and KITTI": "n m0 m1 m2 m3 m4 m5 m6 m7 m8 m9 m10 m11",
    "time and KITTI": "t m0 m1 m2 m3 m4 m5 m6 m7 m8 m9 m10 m11",
    "4x4": " ".join(f"m{k}" for k in range(16)),
    "number and 4x4": "n " + " ".join(f"m{k}" for k in range(16)),
    "planar, degrees": "x y deg",
    "planar, radians": "x y yaw",
    "timed planar": "t x y yaw",
    "timed planar, degrees": "t x y deg",
    "timed planar, unwrapped": "t x y unwrapped",
}
UNTIMED = ("TartanAir", "KITTI", "number and KITTI", "4x4", "number and 4x4", "planar, degrees", "planar, radians")


@pytest.mark.parametrize("name", LAYOUTS)
@pytest.mark.parametrize("separator", [" ", ","])
def test_columns_are_recognised(drive, reading, name, separator):
    found = reading(drive.text(LAYOUTS[name], separator))
    assert found.timed is (name not in UNTIMED)
    drive.check(found, atol=1e-6)


@pytest.mark.parametrize("name", ["TUM", "KITTI", "4x4", "planar, degrees"])
def test_the_usual_layouts_need_no_note(drive, reading, name):
    assert reading(drive.text(LAYOUTS[name])).notes == ()


@pytest.mark.parametrize(
    "name, words",
    [
        (
            "TUM, w first",
            "its quaternions are read as qw qx qy qz.*make `# timestamp tx ty tz qx qy qz qw` its first line",
        ),
        ("RTAB-Map", "9 columns: the last, an id, is left out"),
        ("number first", "9 columns: the first, a number, is left out"),
        ("EuRoC", "17 columns: EuRoC's, quaternions written qw qx qy qz"),
        ("number and KITTI", "13 columns: the first, whole numbers, is no time; left out"),
        ("time and KITTI", "13 columns: the first is read as the time"),
        ("planar, radians", r"the heading is read in radians \(so it turns with the path\)"),
        ("timed planar, degrees", r"the heading is read in degrees \(so it turns with the path\)"),
    ],
)
def test_what_is_guessed_is_said(drive, reading, name, words):
    notes = reading(drive.text(LAYOUTS[name])).notes
    assert re.search(words, notes[0]), notes


def test_six_degrees_of_freedom(hilly, reading):
    for columns in ("t x y z qx qy qz qw", "t x y z qw qx qy qz", LAYOUTS["KITTI"], LAYOUTS["4x4"]):
        hilly.check(reading(hilly.text(columns)), atol=1e-6)
    header = "# timestamp x y z roll pitch yaw"
    found = reading(hilly.text("t x y z roll pitch yaw", " ", header))
    hilly.check(found, atol=1e-6)
    assert "roll, pitch and yaw make the rotation Rz(yaw) Ry(pitch) Rx(roll)" in found.notes[-1]


def test_ros2_topic_echo_csv(drive, reading):
    pose = [line.split(",", 1)[1] for line in drive.text("t x y z qx qy qz qw", ",").splitlines()]
    stamps = [f"{int(t)},{round(t % 1 * 1e9)}" for t in drive.times]
    for frames in ("odom", "odom,base_link"):
        covariance = "" if frames == "odom" else ",0.0" * 78
        text = "".join(f"{s},{frames},{p}{covariance}\n" for s, p in zip(stamps, pose, strict=True))
        found = reading(text)
        drive.check(found)
        assert "as ros2 topic echo --csv writes them" in found.notes[0]


STRAIGHT = "".join(f"{k} {k / 4} 0 0 {{}}\n" for k in range(40))
SHORT = "0 0 0 0.1\n1 1 0 0.2\n2 2 0 0.3\n"


@pytest.mark.parametrize("text, words, header", [
    ("a.jpg 1 0 0 0 1 2 3\n", "line 1: 'a.jpg' is not a number, and no line.*hloc map the world", None),
    ("1 2\n", "line 1: 2 columns; known without a header are 3 .*name the columns in the first line", None),
    ("0 1 2 3 4 5\n", "line 1: 6 columns; known", "# x y z roll pitch yaw"),
    ("0 0 0 0 0 0 0 1 1 2\n", "line 1: 10 columns", "# timestamp tx ty tz qx qy qz qw a b"),
    ("0 1 2 3 0.1 0.2 0.3\n", "7 columns, and the last four are no unit", "# timestamp x y z roll pitch yaw"),
    ("0 0 0 0 1 5 6 7\n", "the quaternion stands before the position", "# timestamp qx qy qz qw x y z"),
    ("5 0 0 0 1 0 0 0 1\n", "9 columns, and both .* fit", "# timestamp tx ty tz qw qx qy qz id"),
    ("5 1 0 0 1 1 0 0 0\n6 1 0 0 3 1 3 0 0\n", "9 columns, and both .* do not fit", None),
    ("1 " * 17 + "\n", "17 columns, but not EuRoC's", None),
    (SHORT, "4 columns, and whether the last is a heading the path does not tell", "# timestamp x y theta_rad"),
    (SHORT, "4 columns", "# timestamp x y theta_deg"),
    ("3 0 0 1\n1 0 0 1\n", "4 columns, and the first is no time", "# n x y theta"),
    (STRAIGHT.replace("{}", "1 0 0 0"), "near 1 0 0 0.*the path does not tell", "# timestamp tx ty tz qw qx qy qz"),
    (STRAIGHT.replace("{}", "1 0 0 0"), "near 1 0 0 0.*the path does not tell", "# timestamp tx ty tz qx qy qz qw"),
])  # fmt: skip
def test_what_stays_ambiguous_is_refused_and_a_header_settles_it(reading, text, words, header):
    with pytest.raises(ValueError, match=f"poses.txt.*{words}"):
        reading(text)
    if header:
        assert len(reading(f"{header}\n{text}").poses) == text.count("\n")


@pytest.mark.parametrize("more", [3, 9])
def test_columns_of_another_order_than_their_programs_are_refused_and_a_header_settles_it(drive, reading, more):
    text = drive.text("t x y z qx qy qz qw" + " 0" * more)
    with pytest.raises(ValueError, match=r"should be written qw qx qy qz.*name the columns in the first line"):
        reading(text)
    drive.check(reading("# timestamp tx ty tz qx qy qz qw" + " -" * more + "\n" + text))
