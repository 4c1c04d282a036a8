"""The command on two files whose clocks differ; what a message advises is then done."""

import json
import re

import numpy as np
import pytest

from ebjax.command import run
from ebjax.evaluation.__main__ import EvaluationConfig, main
from ebjax.io.trajectory import read, write_tum

UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
UNIX = 1403636579.75


@pytest.fixture
def command(tmp_path, capsys):
    """Runs the command on est.txt and ref.txt; gives its exit code, its lines and metrics.json."""

    def evaluate(*flags):
        argv = [str(tmp_path / "est.txt"), str(tmp_path / "ref.txt"), "--out", str(tmp_path / "out"), *map(str, flags)]
        code, metrics = 0, None
        try:
            run(main, EvaluationConfig, argv, needs_jax=False)
            metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
        except SystemExit as stop:
            code = stop.code
        captured = capsys.readouterr()
        assert captured.err.count("\n") == (1 if code else 0) and bool(captured.out) == (code == 0)
        return code, captured.err or captured.out, metrics

    return evaluate


def advised(text):
    """The flags that a message names with numbers."""
    flags = re.findall(r"(--(?:time-offset-s|max-time-difference-s)) (-?\d[\d.e+-]*)\b", text)
    return [word for flag, value in flags for word in (flag, value)]


def write_times(path, times, scale):
    """Writes the rows of a TUM file with its times in another unit, to a thousandth of it."""
    rows = [line.split() for line in path.read_text().splitlines() if not line.startswith("#")]
    path.write_text("".join(f"{time * scale:.3f} {' '.join(row[1:])}\n" for time, row in zip(times, rows, strict=True)))


@pytest.fixture
def files(tmp_path, drive, drifted):
    """Writes ref.txt and est.txt, 60 s of one drive at 5 Hz; gives their common times from 0."""
    times = np.arange(0, 60, 0.2)
    poses = drive(3, times)
    write_tum(tmp_path / "ref.txt", times + UNIX, poses)
    write_tum(tmp_path / "est.txt", times + UNIX, drifted(poses, 3))
    return times


def ates(metrics):
    return [metrics["ate_m"]["time"][name]["rmse"] for name in ("none", "se2", "se3", "sim3")]


@pytest.mark.slow
@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("name", ["est", "ref"])
def test_units_of_dates_are_converted_and_said(files, tmp_path, command, unit, name):
    expected = ates(command()[2])
    write_times(tmp_path / f"{name}.txt", files + UNIX, UNITS[unit])
    code, text, metrics = command()
    assert code == 0 and metrics["matched"]["time"] == len(files)
    assert re.search(rf"{name}\.txt: .*{unit}.* read as seconds", text)
    np.testing.assert_allclose(ates(metrics), expected, rtol=1e-6)


@pytest.mark.parametrize("name", ["est", "ref"])
@pytest.mark.parametrize("part", [slice(None), slice(50, 225)])
def test_milliseconds_from_zero_are_recognised_beside_seconds(files, tmp_path, command, name, part):
    for file in ("est", "ref"):
        trajectory, rows = read(tmp_path / f"{file}.txt"), part if file == name else slice(None)
        write_tum(tmp_path / f"{file}.txt", files[rows], trajectory.poses[rows])
    expected = ates(command()[2])
    write_times(tmp_path / f"{name}.txt", files[part], 1e3)
    _, text, metrics = command()
    assert f"{name}.txt: its times are milliseconds, read as seconds" in text
    np.testing.assert_allclose(ates(metrics), expected, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    "scale, shift, part",
    [(1.0, 0.0, slice(None)), (1.0, 77.7, slice(25, 275)), (1e3, 0.0, slice(75, 250)), (1e3, 77.7, slice(None))],
)
def test_an_offset_is_named_and_not_applied(files, tmp_path, command, scale, shift, part):
    estimate = read(tmp_path / "est.txt")
    times = files[part] - files[part][0] + shift
    write_tum(tmp_path / "est.txt", files[part] + UNIX, estimate.poses[part])
    expected = ates(command()[2])
    write_tum(tmp_path / "est.txt", times, estimate.poses[part])
    write_times(tmp_path / "est.txt", times, scale)
    for most in ((), ("--max-time-difference-s", "1e10")):
        code, text, _ = command(*most)
        assert code == 2
        assert f"the trajectory's times are {shift * scale:.3f} to {times[-1] * scale:.3f} s" in text
        assert f"the reference's {UNIX:.3f} to {UNIX + files[-1]:.3f} s (2014-06-24 19:02:59 UTC, " in text
        assert f"pairs {len(times)} of {len(times)} poses" in text
    flags = advised(text)
    assert flags[0] == "--time-offset-s" and len(flags) == 2
    assert float(flags[1]) == pytest.approx(UNIX + files[part][0] - shift, abs=1e-5)
    code, text, metrics = command(*flags)
    assert code == 0 and metrics["time_offset_s"] == pytest.approx(float(flags[1]))
    assert metrics["matched"]["time"] == len(times) and ("milliseconds" in text) == (scale != 1)
    np.testing.assert_allclose(ates(metrics), expected, rtol=1e-4)


def test_an_offset_between_other_samples_comes_with_a_difference(files, tmp_path, command, drive):
    times = np.arange(10.07, 50, 0.2)
    write_tum(tmp_path / "est.txt", times, drive(3, times))
    code, text, _ = command()
    flags = advised(text)
    assert code == 2 and flags[::2] == ["--time-offset-s", "--max-time-difference-s"]
    assert float(flags[1]) == pytest.approx(UNIX, abs=0.01)
    code, text, metrics = command(*flags)
    assert code == 0 and metrics["matched"]["time"] == len(times) and ates(metrics)[1] < 0.05


@pytest.mark.parametrize("phase", [0.02, -0.024])
def test_a_difference_is_advised_where_the_clocks_agree(files, tmp_path, command, drive, phase):
    write_tum(tmp_path / "est.txt", files + UNIX + phase, drive(3, files + phase))
    code, text, _ = command()
    flags = advised(text)
    assert code == 2 and f"the nearest times {abs(phase):g} s apart (median)" in text
    assert flags[0] == "--max-time-difference-s" and abs(phase) <= float(flags[1]) <= 0.1
    code, text, metrics = command(*flags)
    assert code == 0 and metrics["matched"]["time"] >= len(files) - 1
    assert metrics["time_difference_s"]["max"] == pytest.approx(abs(phase), abs=1e-5)
    assert f"differ by {abs(phase):g} s (median)" in text


def test_few_pairs_are_said_last(files, tmp_path, command):
    estimate = read(tmp_path / "est.txt")
    write_tum(tmp_path / "est.txt", files + UNIX + 55, estimate.poses)
    code, text, _ = command()
    last = text.splitlines()[-2:]
    assert code == 0 and last[0].startswith("275 of the trajectory's 300 poses are left out: 275 after the reference's")
    assert (
        last[1].startswith("few pairs: the trajectory's times are 1403636634.750 to") and "both move alike" in last[1]
    )
    flags = advised(last[1])
    assert float(flags[1]) == pytest.approx(-55, abs=1e-5)
    assert command(*flags)[2]["matched"]["time"] == len(files)


def test_pairs_at_a_wrong_offset_are_doubted(files, tmp_path, command):
    assert "clocks may differ" not in command()[1]
    estimate = read(tmp_path / "est.txt")
    write_tum(tmp_path / "est.txt", files + UNIX - 6, estimate.poses)
    code, text, metrics = command()
    flags = advised(text.splitlines()[-1])
    assert code == 0 and "the clocks may differ" in text and float(flags[1]) == pytest.approx(6, abs=1e-5)
    assert ates(command(*flags)[2])[1] < 0.2 * ates(metrics)[1]


def test_without_a_common_motion_the_way_left_is_along_the_path(files, tmp_path, command, drive):
    other = np.arange(0, 119, 0.05)
    write_tum(tmp_path / "est.txt", other, drive(8, other))
    code, text, _ = command()
    assert code == 2 and "no offset is found at which both move alike" in text and "--match arc" in text
    code, _, metrics = command("--match", "arc")
    assert code == 0 and metrics["matched"] == {"arc": 1500}


@pytest.mark.parametrize(
    "flags, words",
    [
        (("--max-time-difference-s", "-1"), "--max-time-difference-s is -1; give seconds"),
        (("--max-time-difference-s", "nan"), "--max-time-difference-s is nan; give seconds"),
        (("--time-offset-s", "inf"), "--time-offset-s is inf; give seconds"),
        (("--time-offset-s", "3", "--match", "arc"), "--match arc does not look at times; leave it out"),
    ],
)
def test_flags_that_mean_nothing_are_refused(files, command, flags, words):
    code, text, _ = command(*flags)
    assert code == 2 and words in text


@pytest.mark.parametrize("count", [2, 3, 41])
def test_what_no_fit_determines_is_named_and_null(tmp_path, command, count):
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = np.arange(count)
    write_tum(tmp_path / "ref.txt", np.arange(count) * 1.0, poses)
    poses[:, 1, 3] = 0.1 * np.arange(count)
    write_tum(tmp_path / "est.txt", np.arange(count) * 1.0, poses)
    code, text, metrics = command()
    rows = {line[:34].strip(): line[34:] for line in text.splitlines() if line.startswith("ATE")}
    assert code == 0 and metrics["ate_m"]["time"]["se3"] is None and metrics["ate_m"]["time"]["sim3"] is None
    for name in ("se3", "sim3"):
        assert rows[f"ATE m, by time, align {name}"].strip().startswith("undefined (")
        assert metrics["undefined"]["time"][name] in text
    assert 0 < metrics["ate_m"]["time"]["se2"]["rmse"] < 0.07 * count
    assert set(metrics["undefined"]["time"]) == {"se3", "sim3"}


def there_and_back(folder):
    """5 m out and back 0.2 m beside, a pose each 0.5 s; the estimate sways by 5 cm and drifts by 4 mm a pose."""
    k = np.arange(41)
    x, y = np.minimum(k, 40 - k) * 0.25, np.where(k > 20, 0.2, 0.0)
    heading = np.where(k > 20, np.pi, np.where(k == 20, np.pi / 2, 0.0))
    for name, sway, drift, turn in (("ref", 0.0, 0.0, 0.0), ("est", 0.05, 0.004, 0.01 / 41)):
        poses = np.tile(np.eye(4), (41, 1, 1))
        yaw = heading + turn * k
        poses[:, 0, 0], poses[:, 0, 1], poses[:, 1, 0], poses[:, 1, 1] = (
            np.cos(yaw),
            -np.sin(yaw),
            np.sin(yaw),
            np.cos(yaw),
        )
        poses[:, 0, 3], poses[:, 1, 3] = x + sway * np.sin(0.3 * k), y + drift * k
        write_tum(folder / f"{name}.txt", UNIX + 0.5 * k, poses)
    return 0.5 * k


@pytest.mark.parametrize(
    "start, scale, most, advice",
    [
        (UNIX, 1.0, (), []),
        (UNIX, 1e9, (), []),
        (UNIX, 1e9, ("--max-time-difference-s", "1e19"), []),
        (0.0, 1.0, (), ["--time-offset-s", "1403636579.75"]),
        (0.0, 1.0, ("--max-time-difference-s", "1e10"), ["--time-offset-s", "1403636579.75"]),
        (1e6, 1.0, (), ["--time-offset-s", "1402636579.75"]),
    ],
)
def test_whatever_the_clocks_the_error_is_the_same(tmp_path, command, start, scale, most, advice):
    times = there_and_back(tmp_path)
    write_times(tmp_path / "est.txt", times + start, scale)
    code, text, metrics = command(*most)
    assert code == (2 if advice else 0) and advised(text) == advice
    if advice:
        _, text, metrics = command(*advice)
    assert ates(metrics)[1] == pytest.approx(0.059269, abs=1e-6) and metrics["matched"]["time"] == 41
    assert metrics["undefined"]["time"] == {}
