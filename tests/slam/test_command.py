import csv
import json
import re
import shutil

import cv2
import numpy as np
import pytest

from ebjax.command import parse, run
from ebjax.io.trajectory import read_tum
from ebjax.posegraph.g2o import read_g2o
from ebjax.slam.__main__ import Config, main

pytestmark = [pytest.mark.usefixtures("unpainted"), pytest.mark.slow]


def slam(sequence, out, *flags):
    run(main, Config, [str(sequence), "--out", str(out), *flags])
    return json.loads((out / "metrics.json").read_text())


def refused(capsys, sequence, out, *flags):
    """The one line of a run that is refused with exit code 2 and leaves nothing."""
    with pytest.raises(SystemExit) as stop:
        run(main, Config, [str(sequence), "--out", str(out), *flags])
    assert stop.value.code == 2
    assert not out.exists()
    lines = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("frame ")]
    assert len(lines) == 1
    assert lines[0].startswith("error: ")
    return lines[0]


def edit_json(path, **changes):
    values = json.loads(path.read_text()) | changes
    path.write_text(json.dumps({key: value for key, value in values.items() if value is not None}))


def keep_lines(path, count):
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:count]))


def test_closes_the_loop_of_the_way_back(rendered, done):
    out, _, metrics, printed = done
    truth = metrics["closures_against_truth"]
    assert metrics["closures_kept"] >= 3
    assert metrics["closures_opposing"] == metrics["closures_kept"]
    assert truth["within_5cm_1deg"] == truth["checked"] == metrics["closures_kept"]
    assert metrics["ate_rmse_m"]["after"] < min(0.005, 0.1 * metrics["ate_rmse_m"]["before"])
    assert metrics["motion"]["measured"] >= 0.8 * metrics["motion"]["steps"]
    assert metrics["recall_at_1_1m"] >= 0.6
    assert "loop closures kept" in printed

    trajectory = read_tum(out / "trajectory.tum")
    odometry = read_tum(rendered / "odometry.txt")
    assert len(trajectory.poses) == metrics["frames"] == len(odometry.poses)
    np.testing.assert_allclose(trajectory.poses[0], odometry.poses[0], atol=1e-6)
    with open(out / "loop_closures.csv") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == metrics["candidates"]
    assert sum(int(row["kept"]) for row in rows) == metrics["closures_kept"]
    assert all(row["reason"] for row in rows)
    graph, ids = read_g2o(out / "pose_graph.g2o")
    assert len(ids) == metrics["keyframes"]
    with open(out / "steps.csv") as file:
        steps = list(csv.DictReader(file))
    further = sum(int(row["used"]) and int(row["gap"]) > 1 for row in steps)
    assert len(graph.i) == len(ids) - 1 + further + metrics["closures_kept"]
    page = (out / "report.html").read_text()
    assert "http" not in page.split("<body>")[1]
    assert "candidates checked" in page and "verified" not in page and "is turned by pi" in page
    linked = set(re.findall(r'href="(.*?)"', page))
    assert {"trajectory.tum", "loop_closures.csv", "config.yaml", "floor_map.png"} <= linked
    assert all((out / name).is_file() for name in linked)
    assert f"--map {out.parent / 'building.ebmap'}" in page
    assert cv2.imread(str(out / "floor_map.png")) is not None
    assert parse(Config, ["--config", str(out / "config.yaml")]).sequence == rendered


@pytest.mark.whole
def test_without_depth_but_with_another_camera_and_from_a_quad(rendered, sequence, tmp_path):
    pose = np.array(json.loads((rendered / "camera.json").read_text())["T_base_camera"])
    pose[2, 3] *= 1.2
    edit_json(sequence / "camera.json", T_base_camera=pose.tolist())
    right = ["--camera", str(rendered / "camera.json")]
    floor = slam(sequence, tmp_path / "floor", "--depth", "none", *right)
    assert floor["closures_by_depth"] == 0
    assert floor["closures_kept"] >= 3
    assert floor["closures_against_truth"]["within_5cm_1deg"] == floor["closures_kept"]
    quad = slam(rendered, tmp_path / "quad", *["--quad", "180", "250", "460", "250", "600", "440", "40", "440"])
    assert quad["closures_kept"] > 0
    assert quad["closures_against_truth"]["within_5cm_1deg"] == quad["closures_kept"]


@pytest.mark.whole
def test_the_floor_from_depth_is_the_camera_s(rendered, tmp_path, capsys):
    metrics = slam(rendered, tmp_path / "run", "--floor", "depth")
    assert "pitch 19.0" in capsys.readouterr().out
    assert metrics["closures_kept"] >= 3


@pytest.mark.whole
def test_top_keeps_so_many(rendered, tmp_path):
    assert slam(rendered, tmp_path / "run", "--top", "2")["closures_kept"] == 2


@pytest.mark.whole
@pytest.mark.parametrize("extractor", ["sift", "orb"])
def test_other_features_keep_no_wrong_closure(rendered, tmp_path, extractor):
    metrics = slam(rendered, tmp_path / "run", "--extractor", extractor, "--ranking", "cosine")
    truth = metrics.get("closures_against_truth", {"within_5cm_1deg": 0, "checked": 0})
    assert truth["within_5cm_1deg"] == truth["checked"]


@pytest.mark.whole
def test_nothing_repeats_on_the_way_out(sequence, tmp_path):
    keep_lines(sequence / "rgb.txt", 24)
    metrics = slam(sequence, tmp_path / "run")
    assert metrics["closures_kept"] == 0
    assert metrics["nothing_kept"]
    assert metrics["pose_graph"]["converged"]
    assert metrics["ate_rmse_m"]["after"] < 0.2 * metrics["ate_rmse_m"]["before"]
    wheels = slam(sequence, tmp_path / "wheels", "--motion", "wheels", "--mask", "none")
    assert wheels["motion"] is None
    trajectory = read_tum(tmp_path / "wheels" / "trajectory.tum")
    odometry = read_tum(sequence / "odometry.txt")
    np.testing.assert_allclose(trajectory.poses, odometry.poses[:24], atol=1e-6)


@pytest.mark.whole
def test_without_wheels_the_floor_says_how_the_robot_moved(sequence, tmp_path):
    (sequence / "odometry.txt").unlink()
    metrics = slam(sequence, tmp_path / "run", "--depth", "none")
    assert metrics["motion"]["wheels"] is None
    assert metrics["closures_kept"] >= 3
    assert metrics["closures_against_truth"]["within_5cm_1deg"] == metrics["closures_kept"]
    assert metrics["ate_rmse_m"]["after"] < 0.01


@pytest.mark.whole
def test_late_images_and_odometry_that_starts_anew_are_put_right_and_named(sequence, tmp_path, capsys):
    rows = np.loadtxt(sequence / "odometry.txt")
    rows[30:, 1:3] -= rows[30, 1:3]
    np.savetxt(sequence / "odometry.txt", rows, fmt="%.9f")
    for name in ("rgb.txt", "depth.txt"):
        lines = [line.split() for line in (sequence / name).read_text().splitlines() if not line.startswith("#")]
        (sequence / name).write_text("".join(f"{float(stamp) + 0.2:.6f} {file}\n" for stamp, file in lines))
    metrics = slam(sequence, tmp_path / "run")
    printed = capsys.readouterr().out
    assert metrics["motion"]["time_offset"]["offset_s"] == pytest.approx(-0.2, abs=0.03)
    assert [jump["metres"] > 1 for jump in metrics["motion"]["jumps"]] == [True]
    assert "odometry jumps at frame" in printed
    assert "images' clock" in printed
    assert metrics["ate_rmse_m"]["after"] < 0.01


@pytest.mark.whole
def test_broken_frames_are_skipped_counted_and_named(sequence, tmp_path, capsys):
    names = [line.split()[1] for line in (sequence / "rgb.txt").read_text().splitlines()]
    (sequence / names[10]).write_bytes((sequence / names[10]).read_bytes()[:5000])
    (sequence / names[20]).unlink()
    metrics = slam(sequence, tmp_path / "run")
    assert set(metrics["broken_frames"]) == {names[10], names[20]}
    assert metrics["closures_kept"] >= 3
    printed = capsys.readouterr().out
    assert names[10] in printed
    assert names[20] in printed


def test_a_run_that_cannot_be_read_is_refused(sequence, tmp_path, capsys):
    names = [line.split()[1] for line in (sequence / "rgb.txt").read_text().splitlines()]
    for name in names[2:]:
        (sequence / name).write_bytes(b"\xff\xd8 not a picture")
    assert "rgb.txt" in refused(capsys, sequence, tmp_path / "run")
    for name in names[:2]:
        (sequence / name).unlink()
    line = refused(capsys, sequence, tmp_path / "run")
    assert "rgb.txt" in line
    assert names[0] in line


@pytest.mark.parametrize(("flags", "by"), [((), "odometry"), (("--motion", "floor"), "floor")])
def test_a_robot_that_never_moves_has_nothing_to_close(sequence, tmp_path, capsys, flags, by):
    for name in ("rgb", "depth"):
        rows = [line.split() for line in (sequence / f"{name}.txt").read_text().splitlines()][:6]
        (sequence / f"{name}.txt").write_text("".join(f"{stamp} {rows[0][1]}\n" for stamp, _ in rows))
    for name in ("odometry", "groundtruth"):
        rows = np.loadtxt(sequence / f"{name}.txt")
        rows[:, 1:] = rows[0, 1:]
        np.savetxt(sequence / f"{name}.txt", rows, fmt="%.9f")
    line = refused(capsys, sequence, tmp_path / "run", *flags)
    assert f"the robot never moved: by its {by} it stayed within 0.15 m" in line and "in all 6 frames" in line
    assert "could be read" not in line


def test_the_demo_says_in_three_lines_what_happened(rendered, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("ebjax.slam.__main__.demo", lambda folder, beside: rendered)
    run(main, Config, ["--out", str(tmp_path)])
    found, path, look = capsys.readouterr().out.splitlines()
    assert re.match(r"\d+ frames: \d+ loop closures kept of \d+ candidates checked, \d+ from opposing views; ", found)
    assert re.match(r"the path was 0\.\d+ m off the truth, and is 0\.\d+ m off now \(ATE rmse\); [\d.]+ s in all", path)
    assert look == f"look at {tmp_path / 'report.html'}" and (tmp_path / "report.html").is_file()


def test_depth_without_a_number_is_refused(sequence, tmp_path, capsys):
    keep_lines(sequence / "rgb.txt", 12)
    for file in (sequence / "depth").iterdir():
        cv2.imwrite(str(file), np.zeros((480, 640), np.uint16))
    line = refused(capsys, sequence, tmp_path / "run")
    assert "depth.txt" in line
    assert "--depth none" in line


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda s: edit_json(s / "camera.json", fx=None), ["camera.json", "'fx'"]),
        (lambda s: edit_json(s / "camera.json", T_base_camera=None), ["camera.json", "'T_base_camera'"]),
        (lambda s: keep_lines(s / "odometry.txt", 20), ["odometry.txt", "of 5", "--min-coverage"]),
        (lambda s: keep_lines(s / "rgb.txt", 0), ["rgb.txt", "no frames"]),
        (lambda s: keep_lines(s / "rgb.txt", 1), ["rgb.txt", "one frame"]),
        (lambda s: (s / "camera.json").unlink(), ["camera.json"]),
    ],
)
def test_bad_sequences_are_named(sequence, tmp_path, capsys, spoil, words):
    spoil(sequence)
    line = refused(capsys, sequence, tmp_path / "run")
    assert all(word in line for word in words), line


def test_a_camera_of_other_images_is_refused(rendered, tmp_path, capsys):
    shutil.copy(rendered / "camera.json", tmp_path / "other.json")
    edit_json(tmp_path / "other.json", width=320)
    line = refused(capsys, rendered, tmp_path / "run", "--camera", str(tmp_path / "other.json"))
    assert "other.json" in line
    assert "320 x 480" in line


@pytest.mark.parametrize(
    ("flags", "word"),
    [
        (["--quad", "1", "1", "2", "2", "3", "3", "4", "4"], "clockwise"),
        (["--quad", "180", "299", "460", "290", "9000", "443", "66", "462"], "outside"),
        (["--view", "3", "1", "-1", "1"], "x_min"),
        (["--extractor", "surf9"], "surf9"),
        (["--no-such-flag", "1"], "no-such-flag"),
    ],
)
def test_bad_flags_are_named(rendered, tmp_path, capsys, flags, word):
    assert word in refused(capsys, rendered, tmp_path / "run", *flags)


def test_other_programs_get_their_files(done, sequence, tmp_path, capsys):
    """What a map is exported to says the same as the run that was kept in it."""
    out, kept, _, printed = done
    assert f"{kept}: holds the run as session 1" in printed
    for name in ("nav2_map.yaml", "nav2_map.png", "pairs.txt", "transforms.json"):
        assert name in printed and (out / name).is_file()
    run(main, Config, ["--map", str(kept), "--export", "--out", str(tmp_path / "exported")])
    names = {file.name for file in (tmp_path / "exported").iterdir()}
    assert names >= {"trajectory.tum", "pose_graph.g2o", "loop_closures.csv", "floor_map.png", "transforms.json"}

    def both(name, read):
        return [read(folder / name) for folder in (out, tmp_path / "exported")]

    one, other = both("trajectory.tum", read_tum)
    np.testing.assert_array_equal(other.poses, one.poses)
    np.testing.assert_array_equal(other.timestamps, one.timestamps)
    one, other = both("pairs.txt", lambda path: path.read_text())
    assert one == other
    one, other = both("transforms.json", lambda path: json.loads(path.read_text())["frames"])
    ways = ((out, one), (tmp_path / "exported", other))
    images = [[(folder / frame["file_path"]).resolve() for frame in frames] for folder, frames in ways]
    assert images[0] == images[1]
    matrices = [np.array([frame["transform_matrix"] for frame in frames]) for frames in (one, other)]
    np.testing.assert_allclose(*matrices, atol=1e-12)
    one, other = both("pose_graph.g2o", lambda path: read_g2o(path)[0])
    np.testing.assert_allclose(np.asarray(other.poses), np.asarray(one.poses), atol=1e-12)
    np.testing.assert_allclose(np.asarray(other.measured), np.asarray(one.measured), atol=1e-12)

    pose = np.array(json.loads((sequence / "camera.json").read_text())["T_base_camera"])
    pose[2, 3] *= 1.2
    edit_json(sequence / "camera.json", T_base_camera=pose.tolist())
    capsys.readouterr()
    line = refused(capsys, sequence, tmp_path / "none", "--map", str(kept))
    assert "building.ebmap: was made with mount" in line


@pytest.mark.whole
def test_a_run_is_the_same_whatever_keeps_it(rendered, done, tmp_path, monkeypatch):
    """In memory, in a file beside it where the run is long, and in a map."""
    slam(rendered, tmp_path / "short")
    monkeypatch.setattr("ebjax.front.close.MOST_IN_MEMORY", 10)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    slam(rendered, tmp_path / "long")
    assert not list(tmp_path.glob("ebjax-*"))
    for name in ("trajectory.tum", "loop_closures.csv", "pose_graph.g2o"):
        for out in (tmp_path / "long", done.out):
            assert (out / name).read_bytes() == (tmp_path / "short" / name).read_bytes()


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--export"], ["--export is for a map", "--map FILE"]),
        (["LOG", "--map", "MAP", "--export"], ["--export", "leave LOG out"]),
        (["--map", "MAP", "--no-views", "--forget", "1"], ["one of them at a time"]),
        (["--map", "MAP"], ["MAP: there is no such map", "LOG --map MAP"]),
        (["--map", "MAP", "--live"], ["--live shows a run", "name a LOG"]),
        (["--map", "MAP", "--save-rrd", "a.rrd"], ["--save-rrd shows a run"]),
        (["--map", "MAP", "--localise"], ["localise"]),
    ],
)
def test_flags_of_a_map_that_do_not_go_together(tmp_path, monkeypatch, capsys, flags, words):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        run(main, Config, flags)
    assert stop.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ") and all(word in line for word in words), line
    assert not list(tmp_path.iterdir())


def test_a_file_in_the_way_of_the_results_is_known_before_the_run(sequence, tmp_path, capsys):
    (tmp_path / "results").write_text("mine")
    with pytest.raises(SystemExit) as stop:
        run(main, Config, [str(sequence), "--out", str(tmp_path / "results")])
    assert stop.value.code == 2
    assert capsys.readouterr().err == f"error: {tmp_path / 'results'}: is a file; name a folder\n"


def test_a_run_is_recorded_for_rerun(sequence, tmp_path):
    pytest.importorskip("rerun", reason="needs rerun-sdk")
    keep_lines(sequence / "rgb.txt", 8)
    slam(sequence, tmp_path / "run", "--save-rrd", str(tmp_path / "run.rrd"))
    assert (tmp_path / "run.rrd").stat().st_size > 10_000


@pytest.mark.whole
def test_the_real_corridor(data, tmp_path):
    metrics = slam(data("corridor_rgbd"), tmp_path / "run")
    assert metrics["ate_rmse_m"]["before"] == pytest.approx(0.82, abs=0.005)
    assert metrics["ate_rmse_m"]["after"] <= 0.005
    assert metrics["recall_at_1_1m"] >= 0.95
    assert metrics["closures_kept"] >= 14
    assert metrics["closures_against_truth"]["within_5cm_1deg"] == metrics["closures_kept"]


@pytest.mark.whole
def test_the_real_corridor_by_its_floor_alone(data, tmp_path):
    assert slam(data("corridor_rgbd"), tmp_path / "run", "--depth", "none")["ate_rmse_m"]["after"] <= 0.0035


@pytest.mark.whole
def test_the_real_corridor_without_wheels_or_depth(data, tmp_path):
    flags = ["--depth", "none", "--motion", "floor"]
    assert slam(data("corridor_rgbd"), tmp_path / "run", *flags)["ate_rmse_m"]["after"] <= 0.006


@pytest.mark.whole
def test_the_real_corridor_from_four_points(data, tmp_path):
    quad = ["--quad", "180", "299", "460", "290", "585", "443", "66", "462"]
    assert slam(data("corridor_rgbd"), tmp_path / "run", *quad)["ate_rmse_m"]["after"] <= 0.01


@pytest.mark.whole
def test_half_the_real_corridor_closes_nothing(data, tmp_path):
    real = data("corridor_rgbd")
    half = tmp_path / "half"
    half.mkdir()
    for name in ("camera.json", "odometry.txt", "groundtruth.txt", "depth.txt", "rgb.txt"):
        (half / name).write_text((real / name).read_text())
    keep_lines(half / "rgb.txt", 80)
    for name in ("rgb", "depth"):
        (half / name).symlink_to(real.resolve() / name)
    metrics = slam(half, tmp_path / "run")
    assert metrics["closures_kept"] == 0
    assert metrics["ate_rmse_m"]["after"] <= 0.01
