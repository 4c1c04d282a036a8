import json
import re

import cv2
import numpy as np
import pytest

from ebjax.io.logs.open import LogOptions, Topics, open_log
from ebjax.io.poses import poses_from
from ebjax.io.sequence import BrokenFrame, read_sequence, require_odometry
from ebjax.io.trajectory import write_tum

CAMERA = {"fx": 8, "fy": 8, "cx": 4, "cy": 3, "width": 8, "height": 6, "depth_scale": 1000}
MOUNT = [[0, 0, 1, 0.27], [-1, 0, 0, 0], [0, -1, 0, 0.54], [0, 0, 0, 1]]


def tum(times, x=None):
    x = times if x is None else x
    return "# timestamp tx ty tz qx qy qz qw\n" + "".join(
        f"{t:.6f} {v:.6f} 0 0 0 0 0 1\n" for t, v in zip(times, x, strict=True)
    )


@pytest.fixture
def folder(tmp_path):
    """Ten 8x6 frames at 5 Hz with depth 3 ms later, odometry x = t at 10 Hz, ground truth from the fourth frame on."""
    times = 100 + np.arange(10) * 0.2
    (tmp_path / "rgb").mkdir()
    (tmp_path / "depth").mkdir()
    rgb, depth = "", "# depth\n"
    for k, t in enumerate(times):
        cv2.imwrite(str(tmp_path / "rgb" / f"{k}.jpg"), np.full((6, 8, 3), 20 * k, np.uint8))
        cv2.imwrite(str(tmp_path / "depth" / f"{k}.png"), np.full((6, 8), 1000 + k, np.uint16))
        rgb += f"{t:.6f} rgb/{k}.jpg\n"
        depth += f"{t + 0.003:.6f} depth/{k}.png\n"
    (tmp_path / "rgb.txt").write_text(rgb)
    (tmp_path / "depth.txt").write_text(depth)
    (tmp_path / "odometry.txt").write_text(tum(99.95 + np.arange(30) * 0.1))
    (tmp_path / "groundtruth.txt").write_text(tum(times[3:]))
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA | {"T_base_camera": MOUNT}))
    return tmp_path


def test_frames_poses_and_depth(folder):
    run = read_sequence(folder)
    assert len(run) == 10 and run.has_depth and run.dropped == ()
    assert run.names[3] == "rgb/3.jpg"
    np.testing.assert_allclose(run.odom_from_base[:, 0, 3], run.timestamps, atol=1e-9)
    assert np.isnan(run.world_from_base[:3]).all()
    np.testing.assert_allclose(run.world_from_base[3:, 0, 3], run.timestamps[3:], atol=1e-9)
    assert run.rgb(4).shape == (6, 8, 3) and abs(int(run.rgb(4)[0, 0, 0]) - 80) <= 2
    np.testing.assert_allclose(run.depth(7), 1.007, rtol=1e-6)


def write_poses(path, poses):
    write_tum(path, 99.95 + np.arange(len(poses)) * 0.1, poses)


@pytest.fixture
def poses():
    """Thirty poses at 10 Hz on a bend to the left, 3 m long."""
    heading = np.linspace(0, 2, 30)
    rotation = np.stack([[[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]] for a in heading])
    place = np.stack([np.sin(heading) * 1.5, (1 - np.cos(heading)) * 1.5, 0 * heading], axis=1)
    return poses_from(rotation, place)


def test_poses_of_the_camera_are_put_right_with_a_note(folder, poses):
    write_poses(folder / "odometry.txt", poses)
    write_poses(folder / "groundtruth.txt", poses)
    right = read_sequence(folder)
    assert right.notes == ()
    write_poses(folder / "groundtruth.txt", poses @ np.array(MOUNT))
    run = read_sequence(folder)
    assert len(run.notes) == 1 and "groundtruth.txt: holds the poses of the camera's optical frame" in run.notes[0]
    np.testing.assert_allclose(run.world_from_base, right.world_from_base, atol=1e-6)
    moved, expected = run.at_offset(0.05), right.at_offset(0.05)
    np.testing.assert_allclose(moved.world_from_base, expected.world_from_base, atol=1e-6)
    assert moved.notes == run.notes
    write_poses(folder / "odometry.txt", poses @ np.array(MOUNT))
    run = read_sequence(folder)
    assert [note.split(": ")[0].rsplit("/")[-1] for note in run.notes] == ["odometry.txt", "groundtruth.txt"]
    np.testing.assert_allclose(run.odom_from_base, right.odom_from_base, atol=1e-6)


@pytest.mark.parametrize("name", ["odometry.txt", "groundtruth.txt"])
def test_other_columns_are_refused_by_name(folder, poses, name):
    write_poses(folder / name, poses)
    rows = [line.split() for line in (folder / name).read_text().splitlines()[1:]]
    text = "".join(" ".join([*row[:4], row[7], *row[4:7]]) + "\n" for row in rows)
    (folder / name).write_text("# timestamp tx ty tz qx qy qz qw\n" + text)
    with pytest.raises(ValueError, match=rf"{name}: its quaternions are written qw qx qy qz"):
        read_sequence(folder)
    if name == "odometry.txt":
        assert len(read_sequence(folder, odometry=False)) == 10


def test_depth_and_truth_are_optional(folder):
    assert not read_sequence(folder, depth=False).has_depth
    (folder / "depth.txt").unlink()
    (folder / "groundtruth.txt").unlink()
    run = read_sequence(folder)
    assert not run.has_depth and run.world_from_base is None
    with pytest.raises(ValueError, match=r"depth\.txt"):
        run.depth(0)


def test_broken_frames_are_found_when_read(folder):
    whole = (folder / "rgb" / "5.jpg").read_bytes()
    (folder / "rgb" / "5.jpg").write_bytes(whole[: len(whole) // 2])
    (folder / "rgb" / "6.jpg").unlink()
    cv2.imwrite(str(folder / "rgb" / "7.jpg"), np.zeros((3, 4, 3), np.uint8))
    (folder / "depth" / "8.png").write_bytes((folder / "depth" / "8.png").read_bytes()[:-5])
    run = read_sequence(folder)
    for k in (5, 6, 7):
        with pytest.raises(BrokenFrame, match=rf"rgb/{k}\.jpg"):
            run.rgb(k)
    with pytest.raises(BrokenFrame, match=r"depth/8\.png"):
        run.depth(8)
    run.rgb(8)


def test_frames_without_odometry_are_dropped_by_name(folder):
    (folder / "odometry.txt").write_text(tum(99.95 + np.arange(18) * 0.1))
    run = read_sequence(folder)
    assert len(run) == 9 and len(run.dropped) == 1
    assert run.dropped[0][0] == "rgb/9.jpg" and "no odometry pose" in run.dropped[0][1]


def test_sparse_odometry_is_not_interpolated_over_a_gap(folder):
    times = np.array([100.0, 100.2, 100.41, 101.2, 101.4, 101.6, 101.81])
    (folder / "odometry.txt").write_text(tum(times))
    run = read_sequence(folder, min_coverage=0.5, max_gap_s=0.5)
    # 100.4 lies between two samples 0.21 s apart, 101.8 too; 100.6, 100.8 and 101.0 lie in a gap of 0.79 s.
    assert [name for name, _ in run.dropped] == ["rgb/3.jpg", "rgb/4.jpg", "rgb/5.jpg"]
    np.testing.assert_allclose(run.odom_from_base[:, 0, 3], run.timestamps, atol=1e-9)
    words = r"7 of 10 frames .* at most 0\.5 s apart.* lie 0\.205 s apart \(median; the largest gap is 0\.79 s\)"
    with pytest.raises(ValueError, match=rf"odometry\.txt: {words}.*from 100\.000 to 101\.800 s.*--max-gap-s"):
        read_sequence(folder, max_gap_s=0.5)


def test_odometry_at_a_low_rate_runs_as_it_is(folder):
    (folder / "odometry.txt").write_text(tum(100 + np.arange(3) * 1.0))
    run = read_sequence(folder)
    assert len(run) == 10 and run.dropped == () and run.max_gap_s == 2
    np.testing.assert_allclose(run.odom_from_base[:, 0, 3], run.timestamps, atol=1e-9)


def test_a_run_without_odometry_keeps_every_frame(folder):
    given = read_sequence(folder, odometry=False)
    assert given.odom_from_base is None and given.odometry is None and len(given) == 10 and given.notes == ()
    (folder / "odometry.txt").unlink()
    run = read_sequence(folder)
    assert run.odom_from_base is None and len(run) == 10 and run.has_depth and run.dropped == ()
    assert len(run.notes) == 1 and "there is no odometry.txt: the run is measured by the floor alone" in run.notes[0]
    np.testing.assert_array_equal(run.timestamps, given.timestamps)
    np.testing.assert_allclose(run.world_from_base[3:, 0, 3], run.timestamps[3:], atol=1e-9)
    with pytest.raises(
        ValueError, match=r": a calibration needs odometry, and there is no odometry\.txt: .* give rows of poses of"
    ):
        require_odometry(run, "a calibration")
    moved = run.at_offset(0.1)
    assert moved.odom_from_base is None and len(moved) == 10


def test_an_offset_moves_the_images_but_not_their_depth(folder):
    run = read_sequence(folder, time_offset_s=0.07)
    assert len(run) == 10 and run.depth_rows.tolist() == list(range(10))
    np.testing.assert_allclose(run.timestamps, 100.07 + np.arange(10) * 0.2, atol=1e-9)
    np.testing.assert_allclose(run.odom_from_base[:, 0, 3], run.timestamps, atol=1e-9)
    known = np.isfinite(run.world_from_base[:, 0, 3])
    assert known.tolist() == [False] * 3 + [True] * 6 + [False]
    np.testing.assert_allclose(run.world_from_base[known, 0, 3], run.timestamps[known], atol=1e-9)


def test_a_run_at_another_offset_is_the_run_read_with_it(folder):
    run, read = read_sequence(folder).at_offset(0.07), read_sequence(folder, time_offset_s=0.07)
    assert run.time_offset_s == 0.07 and run.names == read.names
    np.testing.assert_allclose(run.timestamps, read.timestamps, atol=1e-9)
    np.testing.assert_allclose(run.odom_from_base, read.odom_from_base, atol=1e-9)
    np.testing.assert_allclose(run.world_from_base, read.world_from_base, atol=1e-9)
    back = run.at_offset(0.0)
    np.testing.assert_allclose(back.odom_from_base, read_sequence(folder).odom_from_base, atol=1e-9)


@pytest.mark.parametrize("offset", [-0.9, 0.9])
def test_no_frame_is_lost_at_another_offset(folder, offset):
    (folder / "odometry.txt").write_text(tum([99.95, 99.951, 100.3, 100.6, 101.3, 101.7999, 101.8]))
    run = read_sequence(folder).at_offset(offset)
    assert len(run) == 10
    np.testing.assert_allclose(run.odom_from_base[:, 0, 3], 100 + np.arange(10) * 0.2 + offset, atol=1e-6)
    with pytest.raises(ValueError, match=r"odometry\.txt: \d+ frames lie more than 1\.02 s outside .*smaller"):
        run.at_offset(2 * offset)


def test_half_the_odometry_says_how_many_matched(folder):
    (folder / "odometry.txt").write_text(tum(100 + np.arange(9) * 0.1))
    with pytest.raises(ValueError, match=r"odometry\.txt: 5 of 10 frames have an odometry pose .*--min-coverage"):
        read_sequence(folder)
    assert len(read_sequence(folder, min_coverage=0.5)) == 5


def test_too_little_depth_says_how_many_matched(folder):
    lines = (folder / "depth.txt").read_text().splitlines()
    (folder / "depth.txt").write_text("\n".join(lines[:6]))
    with pytest.raises(ValueError, match=r"depth\.txt: 5 of 10 frames have a depth image .*--depth none"):
        read_sequence(folder)
    run = read_sequence(folder, min_coverage=0.5)
    with pytest.raises(BrokenFrame, match=r"rgb/9\.jpg: depth\.txt has no image near"):
        run.depth(9)


def test_truth_with_another_clock_is_not_ignored(folder):
    (folder / "groundtruth.txt").write_text(tum(5000 + np.arange(9) * 0.1))
    with pytest.raises(ValueError, match=r"groundtruth\.txt: 0 of 10 frames"):
        read_sequence(folder)


UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}


def rewrite_times(path, shift, scale=1.0):
    rows = [line.split(maxsplit=1) for line in path.read_text().splitlines() if not line.startswith("#")]
    path.write_text("".join(f"{(float(stamp) + shift) * scale:.6f} {rest}\n" for stamp, rest in rows))


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("names", [("rgb", "depth"), ("odometry",), ("groundtruth",), ("rgb", "odometry"), ("depth",)])
def test_units_of_dates_are_converted_and_said(folder, unit, names):
    for name in ("rgb", "depth", "odometry", "groundtruth"):
        rewrite_times(folder / f"{name}.txt", 1.4e9, UNITS[unit] if name in names else 1.0)
    run = read_sequence(folder)
    assert len(run) == 10 and run.depth_rows.tolist() == list(range(10)) and run.dropped == ()
    np.testing.assert_allclose(run.timestamps, 1.4e9 + 100 + np.arange(10) * 0.2, atol=1e-5)
    np.testing.assert_allclose(run.odom_from_base[:, 0, 3], run.timestamps - 1.4e9, atol=1e-5)
    np.testing.assert_allclose(run.world_from_base[3:, 0, 3], run.timestamps[3:] - 1.4e9, atol=1e-5)
    for name in names:
        assert sum(f"{name}.txt" in note and unit in note for note in run.notes) == 1, run.notes


@pytest.mark.parametrize("names", [("rgb", "depth"), ("odometry",), ("groundtruth",)])
def test_milliseconds_of_another_clock_are_recognised_beside_seconds(folder, names):
    for name in names:
        rewrite_times(folder / f"{name}.txt", 0.0, 1e3)
    run = read_sequence(folder)
    assert run.depth_rows.tolist() == list(range(10)) and np.isfinite(run.world_from_base[3:]).all()
    np.testing.assert_allclose(run.odom_from_base[:, 0, 3], run.timestamps, atol=1e-9)
    for name in names:
        assert sum(f"{name}.txt: its times are milliseconds" in note for note in run.notes) == 1


@pytest.mark.parametrize("shift", [-99.95, 1403636579.75, 3600.0])
def test_odometry_of_another_clock_names_both_ranges_and_the_offset(folder, shift):
    rewrite_times(folder / "odometry.txt", shift)
    rewrite_times(folder / "groundtruth.txt", shift)
    first = 99.95 + shift
    with pytest.raises(
        ValueError, match=rf"odometry\.txt: 0 of 10 .*{first:.3f} to .* images are from 100\.000"
    ) as error:
        read_sequence(folder)
    assert "the clocks differ. If both began at once, --time-offset-s" in str(error.value)
    offset, found = re.search(r"--time-offset-s (-?[\d.]+), .* pairs (\d+) of 10", str(error.value)).groups()
    run = read_sequence(folder, time_offset_s=float(offset))
    assert len(run) == int(found) == 10
    np.testing.assert_allclose(run.timestamps[0], first, atol=1e-5)


@pytest.mark.parametrize("shift", [-100.6, 5000.0])
def test_truth_of_another_clock_names_what_to_add(folder, shift):
    rewrite_times(folder / "groundtruth.txt", shift)
    with pytest.raises(ValueError, match=r"groundtruth\.txt: 0 of 10 .* images are from 100\.000 to") as error:
        read_sequence(folder)
    ahead = float(re.search(r"add (-?[\d.]+) s to the times in it, or move the file away", str(error.value)).group(1))
    rewrite_times(folder / "groundtruth.txt", ahead)
    assert np.isfinite(read_sequence(folder).world_from_base[:7]).all()


def test_depth_of_another_clock_names_both_ranges(folder):
    rewrite_times(folder / "depth.txt", 50.0)
    words = r"depth\.txt: 0 of 10 .*150\.003 to 151\.803 s .* 100\.000 to 101\.800 s .*the clocks differ.*--depth none"
    with pytest.raises(ValueError, match=words):
        read_sequence(folder)
    assert not read_sequence(folder, depth=False).has_depth


@pytest.mark.parametrize(
    "name, words",
    [("rgb.txt", "it lacks rgb.txt, a line for every image"), ("camera.json", "there is no camera.json: ")],
)
def test_missing_files_are_named(folder, name, words):
    (folder / name).unlink()
    with pytest.raises(ValueError, match=words):
        read_sequence(folder)


def test_missing_folder(tmp_path):
    with pytest.raises(ValueError, match="nowhere: no such folder or file; give a TUM folder"):
        read_sequence(tmp_path / "nowhere")


def test_depth_of_another_resolution_is_used_and_of_another_shape_is_not(folder):
    cv2.imwrite(str(folder / "depth" / "1.png"), np.arange(1, 13, dtype=np.uint16).reshape(3, 4) * 1000)
    cv2.imwrite(str(folder / "depth" / "2.png"), np.full((6, 6), 1000, np.uint16))
    run = read_sequence(folder)
    np.testing.assert_array_equal(run.depth(1), np.arange(1.0, 13).reshape(3, 4).repeat(2, 0).repeat(2, 1))
    with pytest.raises(BrokenFrame, match=r"depth/2\.png: 6x6 pixels, another shape than the camera's 8x6"):
        run.depth(2)


@pytest.mark.parametrize("name", ["rgb.txt", "depth.txt", "odometry.txt", "groundtruth.txt"])
@pytest.mark.parametrize("fault, words", [("swap", "earlier.*sort the file"), ("repeat", "remove one of the two")])
def test_times_out_of_order_name_file_and_line(folder, name, fault, words):
    lines = [line for line in (folder / name).read_text().splitlines() if not line.startswith("#")]
    lines[3:5] = [lines[4], lines[3]] if fault == "swap" else [lines[3], lines[3].replace(" 0 0 0", " 9 0 0", 1)]
    (folder / name).write_text("\n".join(lines) + "\n")
    with pytest.raises(ValueError, match=rf"{name} line 5: .*{words}"):
        read_sequence(folder)


@pytest.mark.parametrize(
    "name, text, words",
    [
        ("rgb.txt", "", "no frames"),
        ("rgb.txt", "# timestamp file\n", "no frames"),
        ("rgb.txt", "1.0 rgb/0.jpg\n", "one frame only"),
        ("rgb.txt", "1.0 rgb/0.jpg\n2.0\n", "line 2: '2.0' is not `timestamp file`"),
        ("rgb.txt", "nan rgb/0.jpg\n2.0 rgb/1.jpg\n", "line 1: nan is not a finite number"),
        ("odometry.txt", "", "no poses"),
        ("odometry.txt", "1 0 0 nan 0 0 0 1\n", "none of its 1 rows holds a pose"),
        ("depth.txt", "", "no depth images"),
    ],
)
def test_bad_lists_name_file_and_line(folder, name, text, words):
    (folder / name).write_text(text)
    with pytest.raises(ValueError, match=f"{name}.*{words}"):
        read_sequence(folder)


def test_names_with_spaces(folder):
    (folder / "rgb" / "0.jpg").rename(folder / "rgb" / "frame 0.jpg")
    (folder / "rgb.txt").write_text((folder / "rgb.txt").read_text().replace("rgb/0.jpg", "rgb/frame 0.jpg"))
    assert read_sequence(folder).rgb(0).shape == (6, 8, 3)


def test_real_run(data):
    run = read_sequence(data("corridor_rgbd"))
    assert len(run) == 172 and run.has_depth and np.isfinite(run.world_from_base).all()
    assert run.rgb(171).shape == (480, 640, 3) and 1 < np.median(run.depth(0)) < 5


def test_options_of_another_kind_of_log_are_refused(folder):
    for options, words in (
        (LogOptions(session=1), r"--session is for RTAB-Map databases; leave it out here"),
        (LogOptions(topics=Topics(image="/camera")), r"--topics\.\* is for ROS bags"),
        (LogOptions(frames_per_s=5.0), r"--frames-per-s is for videos and folders of images"),
    ):
        with pytest.raises(ValueError, match=words):
            open_log(folder, options)
