import json
import re

import numpy as np
import pytest

from ebjax.command import run
from ebjax.evaluation.__main__ import EvaluationConfig, main
from ebjax.io.trajectory import write_kitti, write_tum


def evaluate(*argv):
    run(main, EvaluationConfig, [str(argument) for argument in argv], needs_jax=False)


def straight(count, step=1.0):
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = np.arange(count) * step
    return poses


@pytest.fixture
def files(tmp_path):
    times = np.arange(20) * 0.1
    estimate = straight(20)
    estimate[:, 1, 3] = 0.5
    write_tum(tmp_path / "estimate.tum", times + 0.004, estimate)
    write_tum(tmp_path / "reference.tum", times[2:], straight(20)[2:])
    return tmp_path / "estimate.tum", tmp_path / "reference.tum"


def test_by_time_prints_how_many_matched(files, tmp_path, capsys):
    evaluate(*files, "--out", tmp_path / "run")
    out = capsys.readouterr().out
    assert "matched 18 of 20 poses to the reference's 18 within 0.01 s" in out
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert metrics["matched"] == {"time": 18} and metrics["poses"] == [20, 18]
    assert metrics["ate_m"]["time"]["none"]["rmse"] == pytest.approx(0.5)
    assert metrics["ate_m"]["time"]["se2"]["rmse"] == pytest.approx(0, abs=1e-8)
    assert metrics["rpe"]["time"]["translation_m"]["max"] == pytest.approx(0, abs=1e-8)


def test_without_times_rows_and_arc_length_stand_side_by_side(tmp_path, capsys):
    # The same road, driven at another pace: every place agrees, no instant does.
    pace = straight(101)
    pace[:, 0, 3] = np.linspace(0, 10, 101) ** 2
    write_kitti(tmp_path / "a.kitti", straight(101))
    write_kitti(tmp_path / "b.kitti", pace)
    evaluate(tmp_path / "a.kitti", tmp_path / "b.kitti", "--out", tmp_path)
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["ate_m"]["row"]["none"]["max"] == pytest.approx(25)
    assert metrics["ate_m"]["arc"]["none"]["max"] == pytest.approx(0, abs=1e-9)
    assert metrics["row_lag_m"] == {"max": pytest.approx(25), "mean": pytest.approx(16.5), "row": 50}
    assert "Why they differ: row by row the two files are up to 25.0 m (row 50" in capsys.readouterr().out
    evaluate(tmp_path / "a.kitti", tmp_path / "a.kitti")
    assert "Why they differ" not in capsys.readouterr().out


@pytest.mark.parametrize(
    "shift, options, words",
    [
        (50.0, (), "0 of 20 poses match a time"),
        (0.0, ("--match", "row"), "20 rows, but .*reference.tum has 18; use --match arc"),
        (0.0, ("--delta", "30"), "estimate.tum against .*no pair 30 rows apart"),
        (0.0, ("--align-first", "-1"), "--align-first is -1"),
        (0.0, ("--match", "arc", "--samples", "1"), "two or more"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(files, tmp_path, capsys, shift, options, words):
    write_tum(files[0], np.arange(20) * 0.1 + shift, straight(20))
    with pytest.raises(SystemExit) as stop:
        evaluate(*files, *options, "--out", tmp_path / "run")
    captured = capsys.readouterr()
    assert stop.value.code == 2 and captured.out == ""
    assert captured.err.startswith("error: ") and captured.err.count("\n") == 1
    assert re.search(words, captured.err)
    assert not (tmp_path / "run").exists()


def test_times_are_needed_to_match_by_time(files, tmp_path, capsys):
    write_kitti(tmp_path / "a.kitti", straight(20))
    with pytest.raises(SystemExit):
        evaluate(tmp_path / "a.kitti", files[1], "--match", "time")
    assert "a.kitti: it has no times; use --match row or --match arc" in capsys.readouterr().err


def test_the_papers_number_and_the_honest_one(data, capsys):
    folder = data("d5_pose_graph")
    evaluate(folder / "vpr5.kitti.gz", folder / "denseGt2.kitti.gz")
    out = capsys.readouterr().out
    rows = {line[:34].strip(): line[34:].split() for line in out.splitlines() if line.startswith("ATE")}
    assert rows["ATE m, by row, align none"][1] == "5.695400"
    assert float(rows["ATE m, by arc length, align none"][1]) == pytest.approx(1.03, abs=0.005)
    assert float(rows["ATE m, by arc length, align se2"][1]) == pytest.approx(0.67, abs=0.005)
    assert out.count("Why they differ") == 1


def test_a_robot_that_stands_still_is_compared_without_alignment(tmp_path, capsys):
    still = np.tile(np.eye(4), (12, 1, 1))
    write_kitti(tmp_path / "still.kitti", still)
    still[:, 0, 3] = 0.25
    write_kitti(tmp_path / "beside.kitti", still)
    evaluate(tmp_path / "still.kitti", tmp_path / "beside.kitti", "--out", tmp_path)
    out = capsys.readouterr().out
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["ate_m"]["row"]["none"]["rmse"] == pytest.approx(0.25)
    assert all(metrics["ate_m"]["row"][name] is None for name in ("se2", "se3", "sim3"))
    assert out.count("undefined (the reference's poses never move") == 3
    assert out.splitlines()[-1].startswith("not compared by arc length: the poses never move")


def test_rows_without_a_pose_keep_the_others_in_step(tmp_path, capsys):
    path = np.tile(np.eye(4), (30, 1, 1))
    path[:, 0, 3], path[:, 1, 3] = np.arange(30.0), np.arange(30.0) ** 2 / 30
    for name, lost in (("a", []), ("b", [4, 5, 11])):
        write_kitti(tmp_path / f"{name}.kitti", path)
        lines = (tmp_path / f"{name}.kitti").read_text().splitlines()
        lines = [" ".join(["nan"] * 12) if k in lost else line for k, line in enumerate(lines)]
        (tmp_path / f"{name}.kitti").write_text("\n".join(lines) + "\n")
    evaluate(tmp_path / "b.kitti", tmp_path / "a.kitti", "--out", tmp_path)
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["matched"] == {"row": 27, "arc": 1500} and metrics["poses"] == [27, 30]
    assert metrics["ate_m"]["row"]["none"]["max"] == pytest.approx(0, abs=1e-9)
    assert metrics["row_lag_m"]["max"] < 0.02


@pytest.mark.parametrize("short", ["estimate.tum", "reference.tum"])
def test_one_pose_is_no_trajectory(files, tmp_path, capsys, short):
    write_tum(tmp_path / short, np.array([0.5]), straight(1))
    with pytest.raises(SystemExit):
        evaluate(*files)
    assert f"{short}: one pose only; an error of a trajectory needs two or more" in capsys.readouterr().err


def test_an_offset_without_times_is_refused(files, tmp_path, capsys):
    write_kitti(tmp_path / "a.kitti", straight(20))
    with pytest.raises(SystemExit):
        evaluate(tmp_path / "a.kitti", files[1], "--time-offset-s", "3")
    assert (
        "--time-offset-s is 3, but " in (said := capsys.readouterr().err) and "a.kitti has no times; leave it" in said
    )
