"""Runs as folders: written whole, read back, gone on with, refused."""

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from ebjax.command import run
from ebjax.config import load_config
from ebjax.floors.__main__ import Config, main
from ebjax.floors.cameras import CameraConfig
from ebjax.floors.plan import PlanConfig
from ebjax.floors.robot import RobotConfig
from ebjax.floors.sequence import CorridorConfig, record
from ebjax.floors.surface import FloorConfig
from ebjax.io.sequence import read_sequence
from ebjax.worlds.render import render_sequence

SMALL = CorridorConfig(
    floor=FloorConfig(texel_m=0.02),
    robot=RobotConfig(distance_m=1.0, step_m=0.5, turn_step_deg=90.0),
    camera=CameraConfig(width=80),
)


def contents(folder):
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    out = tmp_path_factory.mktemp("world") / "run"
    render_sequence(SMALL, out)
    return out


@pytest.mark.slow
def test_written_run_reads_back(written):
    recording, read = record(SMALL), read_sequence(written, depth=True)
    assert len(read) == len(recording) == 8 and read.dropped == ()
    np.testing.assert_allclose(read.world_from_base, recording.world_from_base, atol=1e-6)
    np.testing.assert_allclose(read.odom_from_base, recording.odom_from_base, atol=1e-6)
    np.testing.assert_allclose(read.camera.base_from_camera, recording.camera.base_from_camera, atol=1e-6)
    rgb, depth = recording.frame(3)
    assert np.abs(read.rgb(3).astype(int) - rgb).mean() < 6
    np.testing.assert_allclose(read.depth(3), depth / 1000, atol=1e-6)


def test_the_command_writes_the_same_files_for_the_same_seed(written, tmp_path, capsys):
    out = tmp_path / "again"
    main(Config(floor=SMALL.floor, robot=SMALL.robot, camera=SMALL.camera, out=out))
    assert str(out) in capsys.readouterr().out
    assert len(contents(out)) == 2 * 8 + 6
    assert contents(out) == contents(written)


def test_a_folder_is_written_once(written, tmp_path):
    before = {p: p.stat().st_mtime_ns for p in written.rglob("*")}
    render_sequence(SMALL, written)
    assert before == {p: p.stat().st_mtime_ns for p in written.rglob("*")}
    with pytest.raises(ValueError, match="another run"):
        render_sequence(replace(SMALL, seed=1), written)


def test_interrupted_writing_leaves_nothing(tmp_path, monkeypatch):
    def stop(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr("ebjax.io.write_sequence.write_tum", stop)
    with pytest.raises(KeyboardInterrupt):
        render_sequence(SMALL, tmp_path / "run")
    assert not list(tmp_path.iterdir())


def test_the_command_says_one_line_and_exits_with_2(tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        run(main, Config, ["--out", str(tmp_path / "run"), "--plan.width-m", "-1"], needs_jax=False)
    assert stop.value.code == 2
    assert capsys.readouterr().err == "error: plan.width_m is -1.0: needs a value above 0\n"
    world = tmp_path / "world.yaml"
    world.write_text("floor:\n  family: lava\n")
    with pytest.raises(ValueError, match=r"world\.yaml: key floor\.family is 'lava', not one of"):
        load_config(world, Config)


def test_photographs_become_tiles(tmp_path):
    rng = np.random.default_rng(0)
    for i in range(2):
        cv2.imwrite(str(tmp_path / f"{i}.png"), rng.integers(0, 255, (40, 60, 3), dtype=np.uint8))
    config = replace(SMALL, floor=FloorConfig(family="photograph", texture=tmp_path, texel_m=0.02))
    render_sequence(config, tmp_path / "run")
    assert len(read_sequence(tmp_path / "run", depth=True)) == 8
    (tmp_path / "2.png").write_bytes(b"no image")
    with pytest.raises(ValueError, match=r"2\.png"):
        render_sequence(config, tmp_path / "other")
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(ValueError, match=r"floor.texture is .*empty"):
        render_sequence(replace(config, floor=replace(config.floor, texture=empty)), tmp_path / "other")


@pytest.mark.parametrize("frames", [1, 5])
def test_what_was_interrupted_is_gone_on_with(written, tmp_path, monkeypatch, capsys, frames):
    seen = []

    def interrupted(config, *more):
        recording = record(config, *more)

        def frame(i):
            if len(seen) == frames:
                raise KeyboardInterrupt
            seen.append(i)
            return recording.frame(i)

        return replace(recording, frame=frame)

    monkeypatch.setattr("ebjax.worlds.render.record", interrupted)
    monkeypatch.setattr("ebjax.worlds.render.os.cpu_count", lambda: 1)
    out, partial = tmp_path / "run", tmp_path / ".run.partial"
    with pytest.raises(KeyboardInterrupt):
        render_sequence(SMALL, out, resume=True)
    assert not out.exists() and len(list((partial / "depth").iterdir())) == frames == len(seen)
    (partial / "rgb" / ".1000.jpg.12345678.partial").write_text("as a killed process leaves it")
    with pytest.raises(ValueError, match=rf"{partial}: holds frames of another run; remove it or name another --out"):
        render_sequence(replace(SMALL, seed=1), out, resume=True)
    assert capsys.readouterr().out == ""
    frames = 8
    render_sequence(SMALL, out, resume=True)
    assert seen == list(range(8)), "no frame is rendered twice"
    assert f"{partial}: goes on after" in capsys.readouterr().out
    assert contents(out) == contents(written) and [file.name for file in tmp_path.iterdir()] == ["run"]
    render_sequence(SMALL, out, resume=True)


def test_the_remedies_of_another_runs_frames_work(written, tmp_path):
    partial = tmp_path / ".run.partial"
    shutil.copytree(written, partial)
    other = replace(SMALL, robot=replace(SMALL.robot, distance_m=0.5))
    with pytest.raises(ValueError, match="remove it or name another --out"):
        render_sequence(other, tmp_path / "run", resume=True)
    render_sequence(other, tmp_path / "another", resume=True)
    shutil.rmtree(partial)
    render_sequence(other, tmp_path / "run", resume=True)
    assert contents(tmp_path / "run") == contents(tmp_path / "another")


@pytest.mark.parametrize("resume", [False, True])
def test_bad_values_write_nothing(tmp_path, resume):
    with pytest.raises(ValueError, match=r"^plan.width_m is"):
        render_sequence(replace(SMALL, plan=PlanConfig(width_m=0.5)), tmp_path / "run", resume=resume)
    assert not list(tmp_path.iterdir())
