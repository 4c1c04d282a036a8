import csv
import json
import re

import numpy as np
import pytest

from ebjax.command import run
from ebjax.evaluation.__main__ import NeesConfig, nees
from ebjax.evaluation.nees import log
from ebjax.io.trajectory import write_kitti, write_tum
from ebjax.posegraph import make_graph
from ebjax.posegraph.g2o import format_g2o

COVARIANCE = ("cov_xx", "cov_xy", "cov_xt", "cov_yy", "cov_yt", "cov_tt")
MEASURED = ("i", "j", "name_i", "name_j", "time_i_s", "time_j_s")
STEPS = (*MEASURED, "gap", "kind", "inliers", "matches", "x_m", "y_m", "theta_rad", *COVARIANCE, "used", "reason")
CLOSURES = (
    *(*MEASURED, "direction", "distance", "inliers", "matches", "x_m", "y_m", "theta_rad", *COVARIANCE),
    *("measured_by", "kept", "reason"),
)
SIGMA = np.array([[0.004, 0.0, 0.0], [0.001, 0.003, 0.0], [0.0005, 0.0008, 0.001]])
FRAMES, GAPS, STEP = 240, (1, 4), np.array([0.2, 0.0, 0.03])


def compose(a, b):
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x, y, theta = np.moveaxis(b, -1, 0)
    return np.stack([a[..., 0] + c * x - s * y, a[..., 1] + s * x + c * y, a[..., 2] + theta], -1)


def inverse(a):
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack([-c * a[..., 0] - s * a[..., 1], s * a[..., 0] - c * a[..., 1], -a[..., 2]], -1)


def exp(e):
    x, y, half = e[..., 0], e[..., 1], e[..., 2] / 2
    c, s = np.cos(half) * np.sinc(half / np.pi), np.sin(half) * np.sinc(half / np.pi)
    return np.stack([c * x - s * y, s * x + c * y, e[..., 2]], -1)


def matrices(poses):
    out = np.tile(np.eye(4), (len(poses), 1, 1))
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    out[:, 0, 0], out[:, 0, 1], out[:, 1, 0], out[:, 1, 1] = c, -s, s, c
    out[:, :2, 3] = poses[:, :2]
    return out


def measure(rng, truth, i, j, scale=1.0):
    """Measurements with true = measured * exp(e), e of covariance SIGMA SIGMA^T scale^2."""
    error = scale * rng.normal(size=(len(i), 3)) @ SIGMA.T
    return compose(compose(inverse(truth[i]), truth[j]), inverse(exp(error)))


def rows(times, i, j, measured, extra):
    upper = (SIGMA @ SIGMA.T)[np.triu_indices(3)]
    for a, b, pose, more in zip(i, j, measured, extra, strict=True):
        yield {
            **dict(i=a, j=b, name_i=f"{a}.png", name_j=f"{b}.png", time_i_s=times[a], time_j_s=times[b]),
            **dict(zip(("x_m", "y_m", "theta_rad"), pose, strict=True)),
            **dict(zip(COVARIANCE, upper, strict=True)),
            **dict(inliers=50, matches=90, reason="", **more),
        }


def write(path, columns, table):
    with open(path, "w", newline="", encoding="utf-8") as file:
        out = csv.DictWriter(file, columns)
        out.writeheader()
        out.writerows(table)


def write_run(folder, scale=1.0, seed=0):
    """A drive round a circle, errors `scale` times as large as claimed; the graph is a chain of steps."""
    rng = np.random.default_rng(seed)
    times = 10 + 0.1 * np.arange(FRAMES)
    truth = np.zeros((FRAMES, 3))
    for k in range(1, FRAMES):
        truth[k] = compose(truth[k - 1], STEP)
    later = np.concatenate([np.arange(gap, FRAMES) for gap in GAPS])
    earlier = np.concatenate([np.arange(FRAMES - gap) for gap in GAPS])
    gap = later - earlier
    extra = [dict(gap=g, kind="depth" if k % 3 else "floor", used=int(k % 10 > 0)) for k, g in enumerate(gap)]
    measured = measure(rng, truth, later, earlier, scale)
    measured[::10, 0] += 1.0  # those that are not used
    write(folder / "steps.csv", STEPS, rows(times, later, earlier, measured, extra))
    i, j = np.arange(200, 240), np.arange(40)
    extra = [dict(direction="same", distance=0.1, measured_by="floor", kept=int(k % 4 > 0)) for k in range(40)]
    write(folder / "loop_closures.csv", CLOSURES, rows(times, i, j, measure(rng, truth, i, j, scale), extra))
    first, second = np.arange(FRAMES - 1), np.arange(1, FRAMES)
    odometry = measure(rng, truth, first, second, scale)
    poses = np.zeros((FRAMES, 3))
    for k in range(1, FRAMES):
        poses[k] = compose(poses[k - 1], odometry[k - 1])
    information = np.tile(np.linalg.inv(SIGMA @ SIGMA.T), (FRAMES - 1, 1, 1))
    (folder / "pose_graph.g2o").write_text(format_g2o(make_graph(poses, first, second, odometry, information)))
    write_tum(folder / "trajectory.tum", times, matrices(poses), "base_link")
    # The truth lies between the frames, and in a world of its own.
    half = exp(log(STEP[None]) / 2)[0]
    true = compose(
        np.array([5.0, 2.0, 1.0]), compose(np.concatenate([truth, compose(truth[-1:], STEP)]), inverse(half))
    )
    write_tum(folder / "groundtruth.txt", np.append(times, times[-1] + 0.1) - 0.05, matrices(true), "base")
    return folder


def command(folder, *options):
    run(nees, NeesConfig, [str(folder), "--reference", str(folder / "groundtruth.txt"), *map(str, options)])


def results(folder, *options):
    command(folder, "--out", folder / "out", *options)
    return json.loads((folder / "out" / "nees.json").read_text())


def test_errors_as_large_as_their_covariance_have_mean_3(tmp_path, capsys):
    found = results(write_run(tmp_path), "--distances", "1", "5", "20", "90")
    assert set(found["steps"]) == {"all", "gap 1", "gap 4", "kind depth", "kind floor"}
    for values in (*found["steps"].values(), *found["closures"].values()):
        assert values["nees_mean_interval"][0] < values["nees_mean"] < values["nees_mean_interval"][1]
    assert found["steps"]["all"]["n"] == 427 and found["closures"]["all"]["n"] == 30
    claimed = np.sqrt(np.trace((SIGMA @ SIGMA.T)[:2, :2]))
    assert found["steps"]["all"]["rms_sigma_m"] == pytest.approx(claimed, rel=1e-6)
    assert found["steps"]["all"]["rms_error_m"] == pytest.approx(claimed, rel=0.1)
    assert list(found["relative"]) == ["1 m", "5 m", "20 m"]
    for name, low, high in (("1 m", 2, 4.5), ("5 m", 1.5, 5), ("20 m", 0.5, 8)):
        assert found["relative"][name]["n"] == 40 and low < found["relative"][name]["nees_mean"] < high
    # A chain adds the headings' variances up: 5, 25 and 100 steps of 0.2 m.
    heading = np.degrees(np.sqrt((SIGMA @ SIGMA.T)[2, 2]))
    for name, steps in (("1 m", 5), ("5 m", 25), ("20 m", 100)):
        assert found["relative"][name]["rms_sigma_deg"] == pytest.approx(heading * np.sqrt(steps), rel=0.03)
    out = capsys.readouterr().out
    assert "relative, 90 m: no two frames with truth are that far apart" in out
    assert "steps.csv: 475 rows, 427 used, 427 of them with truth" in out and "truth for 240 of 240 frames" in out
    assert re.search(r"^steps, gap 4 +\d+ ", out, re.M) and re.search(r"^relative, 20 m +40 ", out, re.M)


def test_covariances_too_small_by_nine_have_mean_27(tmp_path):
    found = results(write_run(tmp_path, scale=3.0))
    assert found["steps"]["all"]["nees_mean"] == pytest.approx(27, rel=0.1)
    assert found["closures"]["all"]["nees_mean"] == pytest.approx(27, rel=0.3)
    assert found["relative"]["1 m"]["nees_mean"] > 15


def test_frames_without_truth_are_left_out_and_counted(tmp_path, capsys):
    folder = write_run(tmp_path)
    lines = (folder / "groundtruth.txt").read_text().splitlines(keepends=True)
    (folder / "groundtruth.txt").write_text("".join(lines[:102] + lines[162:]))
    found = results(folder)
    out = capsys.readouterr().out
    assert "truth for 179 of 240 frames" in out and found["steps"]["all"]["n"] < 330
    assert found["steps"]["all"]["nees_mean"] == pytest.approx(3, abs=0.4)


def test_a_graph_may_hold_some_of_the_frames_in_any_order(tmp_path):
    folder, kept = write_run(tmp_path), []
    for line in (folder / "pose_graph.g2o").read_text().splitlines():
        tag, first, second = line.split()[:3]
        if int(first) >= 100 and (tag.startswith("VERTEX") or int(second) >= 100):
            kept.append(line)
    (folder / "pose_graph.g2o").write_text("\n".join(reversed(kept)) + "\n")
    found = results(folder)["relative"]
    assert found["1 m"]["n"] == 40 and 2 < found["1 m"]["nees_mean"] < 4.5
    assert found["20 m"]["rms_sigma_deg"] == pytest.approx(np.degrees(np.sqrt(100 * (SIGMA @ SIGMA.T)[2, 2])), rel=0.03)


@pytest.mark.parametrize("steps", [None, "", "header"])
def test_a_run_without_steps_has_closures_alone(tmp_path, capsys, steps):
    path = write_run(tmp_path) / "steps.csv"
    header = path.read_text().splitlines()[0]
    path.unlink()
    if steps is not None:
        path.write_text(header + "\n" if steps else "")
    command(tmp_path)
    out = capsys.readouterr().out
    assert re.search(r"steps.csv: .*the steps are left out", out)
    assert re.search(r"^closures +30 ", out, re.M) and not re.search(r"^steps +\d", out, re.M)


def edit(name, old, new):
    def change(folder):
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    return change


def cell(name, line, column, value, columns=STEPS):
    def change(folder):
        table = list(csv.reader((folder / name).read_text().splitlines()))
        table[line - 1][columns.index(column)] = value
        (folder / name).write_text("\n".join(",".join(row) for row in table) + "\n")

    return change


def shift(folder):
    lines = np.loadtxt(folder / "groundtruth.txt")
    lines[:, 0] += 1000
    np.savetxt(folder / "groundtruth.txt", lines)


def untimed(folder):
    write_kitti(folder / "groundtruth.txt", matrices(np.zeros((5, 3))))


def another_vertex(folder):
    text = (folder / "pose_graph.g2o").read_text()
    (folder / "pose_graph.g2o").write_text(text.replace("SE2 239 ", "SE2 400 ").replace("SE2 238 239", "SE2 238 400"))


@pytest.mark.parametrize(
    "change, options, words",
    [
        (lambda folder: (folder / "trajectory.tum").unlink(), (), "trajectory.tum: no such file"),
        (lambda folder: (folder / "groundtruth.txt").unlink(), (), "groundtruth.txt: no such file"),
        (lambda folder: (folder / "loop_closures.csv").unlink(), (), "loop_closures.csv: no such file"),
        (lambda folder: (folder / "pose_graph.g2o").unlink(), (), "pose_graph.g2o: no such file"),
        (edit("loop_closures.csv", "cov_xx", "sigma_x_m"), (), "loop_closures.csv: no column cov_xx; write the run"),
        (edit("steps.csv", ",gap,kind", ",lag,sort"), (), "steps.csv: no column gap, kind; "),
        (cell("steps.csv", 3, "x_m", "here"), (), "steps.csv line 3: x_m is 'here'; it must be a finite number"),
        (cell("steps.csv", 3, "cov_tt", "nan"), (), "steps.csv line 3: cov_tt is 'nan'"),
        (cell("steps.csv", 4, "cov_xx", "-1"), (), "steps.csv line 4: the covariance is not positive definite"),
        (cell("steps.csv", 5, "i", "240"), (), "steps.csv line 5: i is '240', and trajectory.tum has frames 0 to 239"),
        (cell("steps.csv", 5, "j", "200"), (), "steps.csv line 5: time_j_s is 10.3.*frame 200 .* 30.0.*one run"),
        (cell("steps.csv", 5, "used", "yes"), (), "steps.csv line 5: used is 'yes'; it must be 1 or 0"),
        (cell("steps.csv", 5, "reason", "a,b"), (), "steps.csv line 5: not 21 fields"),
        (lambda folder: (folder / "steps.csv").write_bytes(b"\xff\xfe\x00"), (), "steps.csv: not a table of text"),
        (shift, (), "groundtruth.txt: from 1009.950 .* 0 of the run's 240 frames, from 10.000 to 33.900 s; give"),
        (untimed, (), "groundtruth.txt: it has no times"),
        (another_vertex, (), "pose_graph.g2o: it has vertex 400, no frame of the run"),
        (lambda folder: None, ("--distances", "0"), "must be positive"),
        (lambda folder: None, ("--pairs", "0"), "must be positive"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(tmp_path, capsys, change, options, words):
    change(write_run(tmp_path))
    with pytest.raises(SystemExit) as stop:
        command(tmp_path, "--out", tmp_path / "out", *options)
    captured = capsys.readouterr()
    assert stop.value.code == 2 and captured.out == ""
    assert captured.err.startswith("error: ") and captured.err.count("\n") == 1
    assert re.search(words, captured.err), captured.err
    assert not (tmp_path / "out").exists()


def test_the_reference_must_be_named(tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        run(nees, NeesConfig, [str(tmp_path)])
    assert stop.value.code == 2 and "--reference" in capsys.readouterr().err


def test_the_scale_that_a_run_says_it_shares_counts_in_relative_poses(tmp_path, capsys):
    folder = write_run(tmp_path)
    before = results(folder)
    (folder / "metrics.json").write_text('{"motion": {"scale_sigma": 0.01}}')
    after = results(folder)
    assert "a scale known to 1.000 %" in capsys.readouterr().out
    assert after["steps"] == before["steps"] and after["closures"] == before["closures"]
    for name in ("5 m", "20 m"):
        assert after["relative"][name]["nees_mean"] < before["relative"][name]["nees_mean"]
    assert after["relative"]["20 m"]["rms_sigma_m"] > 0.05
    (folder / "metrics.json").write_text('{"motion": null}')
    assert results(folder) == before


@pytest.mark.parametrize("text", ["{", "[]", '{"motion": {"scale_sigma": "x"}}', '{"motion": {"scale_sigma": -1}}'])
def test_damaged_metrics_are_named(tmp_path, capsys, text):
    folder = write_run(tmp_path)
    (folder / "metrics.json").write_text(text)
    with pytest.raises(SystemExit) as stopped:
        command(folder)
    assert stopped.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "metrics.json" in line and "take it from the run, or remove it" in line
