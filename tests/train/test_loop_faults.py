"""What may befall a training: killed, its checkpoint damaged, its config changed, its disk full."""

import importlib
import json
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
toy_training = importlib.import_module("toy_training")
EVERY, STEPS, fit = toy_training.EVERY, toy_training.STEPS, toy_training.fit
CHECKPOINTS = "checkpoints"


def log(out):
    lines = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    return [{key: value for key, value in line.items() if key != "seconds"} for line in lines]


def kept(out):
    return sorted(int(path.name) for path in (out / CHECKPOINTS).iterdir())


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A training that nothing befell, and its last metrics."""
    out = tmp_path_factory.mktemp("whole")
    return out, fit(out)


def test_a_whole_training(whole):
    out, metrics = whole
    lines = log(out)
    assert [line["step"] for line in lines if line["kind"] == "step"] == list(range(1, STEPS + 1))
    assert [line["step"] for line in lines if line["kind"] == "validation"] == list(range(0, STEPS + 1, EVERY))
    assert kept(out) == [STEPS - EVERY, STEPS] and lines[-1]["score"] == metrics["score"]


@pytest.mark.slow
def test_killed_at_any_moment_it_ends_with_the_same_numbers(whole, tmp_path):
    for flags, killed, left in (([], "1", []), (["--resume"], "saving", [3]), (["--resume"], "removing", [3, 6, 9])):
        program = [sys.executable, toy_training.__file__, "--out", str(tmp_path), *flags]
        environment = {**os.environ, "TOY_KILL": killed}
        ended = subprocess.run(program, env=environment, capture_output=True, text=True, timeout=120)
        assert ended.returncode == -9, ended.stderr
        assert sorted(int(path.name) for path in (tmp_path / CHECKPOINTS).glob("[0-9]*")) == left
    metrics = fit(tmp_path, resume=True)
    assert metrics == whole[1] and log(tmp_path) == log(whole[0]) and kept(tmp_path) == kept(whole[0])
    assert (tmp_path / "best.json").read_text() == (whole[0] / "best.json").read_text()


def test_what_is_done_stays_done(whole, tmp_path):
    out = shutil.copytree(whole[0], tmp_path / "out")
    assert fit(out, resume=True) == whole[1] and log(out) == log(whole[0])
    with pytest.raises(ValueError, match="holds a training; give --resume"):
        fit(out)


def test_early_stop_is_remembered(tmp_path, capsys):
    scores = {"patience": 2, "better": [0.0, 5.0, 4.0, 3.0, 9.0]}
    fit(tmp_path, **scores)
    assert kept(tmp_path) == [2 * EVERY, 3 * EVERY] and "2 validations without" in capsys.readouterr().out
    fit(tmp_path, **scores, resume=True)
    assert (
        kept(tmp_path) == [2 * EVERY, 3 * EVERY] and json.loads((tmp_path / "best.json").read_text())["step"] == EVERY
    )


def _cut_off(folder):
    for path in folder.rglob("*"):
        if path.is_file():
            path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _without_place(folder):
    (folder / "place.json").unlink()


def _changed(folder):
    for path in (folder / "state").rglob("d/*"):
        content = bytearray(path.read_bytes())
        content[len(content) // 2 :: 7] = bytes(len(content[len(content) // 2 :: 7]))
        path.write_bytes(content)


@pytest.mark.parametrize("damage", [_cut_off, _without_place, _changed])
def test_a_damaged_checkpoint_is_named_and_the_one_before_serves(whole, tmp_path, damage):
    out = shutil.copytree(whole[0], tmp_path / "out")
    last = out / CHECKPOINTS / str(STEPS)
    damage(last)
    with pytest.raises(
        ValueError, match=f"{STEPS}: this checkpoint cannot be read; delete .* from step {STEPS - EVERY}"
    ):
        fit(out, resume=True)
    shutil.rmtree(last)
    assert fit(out, resume=True) == whole[1] and log(out) == log(whole[0])


def test_another_config_is_refused(whole, tmp_path):
    out = shutil.copytree(whole[0], tmp_path / "out")
    with pytest.raises(ValueError, match=r"rate 0.05, the config says 0.1; restore the config, or give another --out"):
        fit(out, resume=True, rate=0.1)
    assert kept(out) == kept(whole[0])


def test_a_full_disk_is_told_and_costs_no_checkpoint(tmp_path, capfd):
    size = 20_000
    complete = fit(tmp_path / "complete", size=size, steps=EVERY)
    out = shutil.copytree(tmp_path / "complete", tmp_path / "out")
    place = out / CHECKPOINTS / str(EVERY) / "place.json"
    place.write_text(place.read_text().replace(f'"loop.steps": {EVERY}', f'"loop.steps": {STEPS}'))
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))
    try:
        with pytest.raises(OSError, match=f"step {2 * EVERY} cannot be kept .File too large.$"):
            fit(out, size=size, resume=True)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert "Traceback" not in capfd.readouterr().err
    assert kept(out) == [EVERY] and complete["score"] == log(out)[EVERY + 1]["score"]
    fit(out, size=size, resume=True)
    assert kept(out) == [STEPS - EVERY, STEPS]
