import csv
import dataclasses
import json
from pathlib import Path

import numpy as np

from ebjax.features.settle import PairMatches
from ebjax.features.verify_pairs import rows_of
from ebjax.geometry.camera import camera_over_floor
from ebjax.io.camera_file import CameraFile
from ebjax.io.logs.log import Images, Log
from ebjax.io.sequence import Sequence
from ebjax.odometry.chain import Edges
from ebjax.odometry.clock import TimeOffset
from ebjax.odometry.floor_steps import FloorPairs
from ebjax.odometry.fuse import Jump
from ebjax.odometry.height import Reach
from ebjax.odometry.motion import Motion
from ebjax.odometry.mount import Tilt
from ebjax.odometry.steps import USED, Steps
from ebjax.odometry.wheels import Systematic
from ebjax.viz.motion import COLUMNS, motion_lines, motion_metrics, write_steps

FRAMES = np.array([0, 5, 10, 15, 20])


def motion(**changed):
    """Five keyframes: two steps by the floor, one by the image, one by nothing; two further pairs, one refused."""
    i, j = np.array([1, 2, 2, 3, 4, 4]), np.array([0, 1, 0, 2, 3, 2])
    kind = np.array(["floor", "depth", "floor", "image", "floor", "floor"], object)
    reason = np.array([USED, USED, USED, USED, "few matches", "12 of 80 agree"], object)
    many = np.array([60, 61, 62, 63, 4, 12])
    i_from_j = np.stack([-0.2 * (i - j), 0.01 * i, 0.001 * i], 1)
    covariance = np.tile(np.array([[4e-6, 1e-6, 2e-6], [1e-6, 5e-6, 3e-6], [2e-6, 3e-6, 6e-6]]), (6, 1, 1))
    steps = Steps(i, j, kind, many, many + 20, i_from_j, covariance, reason)
    poses = np.stack([0.2 * np.arange(5), np.zeros(5), np.zeros(5)], 1)
    rows = np.arange(4)
    chain = Edges(rows, rows + 1, np.diff(poses, axis=0), np.tile(np.eye(3), (4, 1, 1)), np.zeros(4, bool))
    none = rows[:0]
    deep, flat = np.zeros((0, 4, 3)), np.zeros((0, 4, 2))
    matches = PairMatches(flat, flat, deep, deep, np.zeros((0, 4), bool), np.zeros((0, 3)), np.zeros((0, 4, 2, 2)))
    plain = Motion(
        frames=FRAMES,
        camera=camera_over_floor(400.0, 400.0, 320.0, 240.0, 640, 480, 0.6, 0.5),
        poses=poses,
        covariance=np.tile(np.eye(3), (4, 1, 1)),
        chain=chain,
        further=Edges(*(column[:0] for column in chain)),
        steps=steps,
        wheels=None,
        offset=TimeOffset(),
        tilt=Tilt(),
        reach=None,
        jumps=(),
        carried=1,
        trust_depth=False,
        warnings=(),
        pairs=FloorPairs(none, none, none, none, rows_of(matches)),
        bridged=steps,
    )
    return dataclasses.replace(plain, **changed)


def lines(**changed):
    metrics = {"motion": motion_metrics(motion(**changed))}
    assert json.loads(json.dumps(metrics, allow_nan=False)) == metrics
    return motion_lines(metrics)


def test_steps_are_counted_by_what_measured_them():
    found = motion_metrics(motion())
    names = ("steps", "measured", "bridged", "spanned", "carried", "pairs_measured", "pairs_refused")
    assert [found[name] for name in names] == [4, 2, 1, 0, 1, 4, 2]
    assert found["refused"] == {"few matches": 1, "12 of 80 agree": 1}
    (said,) = lines()
    floor_and_image = "steps: 2 of 4 measured on the floor, 1 by the whole image"
    assert said == f"{floor_and_image}, 0 by frames further apart, 1 by nothing; 2 of 6 pairs refused"


def test_no_motion_says_nothing():
    assert motion_lines({"motion": None}) == []


def test_a_jump_is_named_with_its_frame_and_metres():
    _, said = lines(jumps=(Jump(15, 3.25, 12.04, 0.5),))
    for word in ("jumps at frame 15", "3.25 m", "12.0 degrees", "0.50 s"):
        assert word in said


def test_only_five_jumps_are_told():
    _, *said = lines(jumps=tuple(Jump(k, 1.0 + k, 0.0, 0.1) for k in range(8)))
    assert len(said) == 6
    assert "frame 4" in said[4] and "3 more frames" in said[5]


def test_wheels_clock_and_mount():
    wheels = Systematic(1.0312, 0.9456, -0.75, 0.02, (0.0021, 0.0043, 0.11, 0.004), 90)
    offset = TimeOffset(-0.512, 0.0042, "the turning rates of images and odometry fit then")
    tilt = Tilt(0.512, -0.234, 0.012, 0.023, 80, True)
    reach = Reach(0.021, -0.034, 0.004, 0.005)
    _, counted, clock, mount, moved = lines(wheels=wheels, offset=offset, tilt=tilt, reach=reach)
    for line, words in (
        (counted, ("1.0312 +- 0.0021 m", "0.9456 +- 0.0043", "-0.75 +- 0.11 degrees")),
        (clock, ("-0.512 +- 0.004 s", "turning rates")),
        (mount, ("pitch +0.512 +- 0.012", "roll -0.234 +- 0.023", "put right")),
        (moved, ("height +0.0210 +- 0.0040", "x -0.0340 +- 0.0050")),
    ):
        for word in words:
            assert word in line
    found = motion_metrics(motion(wheels=wheels, offset=offset, tilt=tilt, reach=reach, warnings=("look",)))
    assert found["wheels"]["sigma"] == list(wheels.sigma) and found["wheels"]["rest_deg_per_s"] == 0.02
    assert found["time_offset"] == {"offset_s": -0.512, "sigma_s": 0.0042, "why": offset.why}
    assert found["mount"]["applied"] and found["mount"]["x_m"] == -0.034
    assert found["warnings"] == ["look"]


def test_what_was_not_put_right_is_no_line():
    offset = TimeOffset(0.0, float("inf"), "turns too little or too evenly to tell: stays 0")
    assert len(lines(offset=offset, tilt=Tilt(0.01, 0.02, 0.05, 0.05, 30, False))) == 1
    assert motion_metrics(motion(offset=offset))["time_offset"]["sigma_s"] is None


def test_the_table_has_a_row_a_step(tmp_path):
    names = tuple(f"{k}.png" for k in range(21))
    camera = CameraFile(np.eye(3), np.eye(4), 640, 480, 1000.0)
    times = 0.1 * np.arange(21.0)
    log = Log(Path("."), "folder", Images("rgb.txt", names, times, lambda k: np.zeros((480, 640, 3), np.uint8)))
    sequence = Sequence(log, np.arange(21), times, None, None, camera)
    one = motion()
    write_steps(tmp_path / "steps.csv", sequence, one)
    with open(tmp_path / "steps.csv", newline="", encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    assert tuple(head) == COLUMNS and {len(row) for row in rows} == {len(COLUMNS)}
    table = [dict(zip(head, row, strict=True)) for row in rows]
    assert [(row["i"], row["j"], row["gap"]) for row in table[:3]] == [
        ("5", "0", "1"),
        ("10", "5", "1"),
        ("10", "0", "2"),
    ]
    assert table[3]["name_i"] == "15.png" and table[3]["kind"] == "image" and float(table[3]["time_j_s"]) == 1.0
    assert [row["used"] for row in table] == ["1", "1", "1", "1", "0", "0"]
    assert table[5]["reason"] == "12 of 80 agree"
    for k, row in enumerate(table):
        measured = [float(row[name]) for name in ("x_m", "y_m", "theta_rad")]
        np.testing.assert_allclose(measured, one.steps.i_from_j[k], atol=1e-7)
        upper = [float(row[f"cov_{name}"]) for name in ("xx", "xy", "xt", "yy", "yt", "tt")]
        np.testing.assert_allclose(upper, one.steps.covariance[k][np.triu_indices(3)], rtol=1e-6)
