from dataclasses import replace
from pathlib import Path

import cv2
import jax
import numpy as np
import pytest

from ebjax.command import run
from ebjax.config import load_config
from ebjax.floors.__main__ import Config, main, render_sequence
from ebjax.floors.cameras import CameraConfig
from ebjax.floors.passers import PassersConfig
from ebjax.floors.plan import PlanConfig
from ebjax.floors.robot import RobotConfig, drive
from ebjax.floors.sensor import SensorConfig
from ebjax.floors.sequence import CorridorConfig, check, check_inside, moments, plan_of, record
from ebjax.floors.surface import FloorConfig
from ebjax.io.sequence import read_sequence

WORLDS = Path(__file__).parents[2] / "configs" / "worlds"
SMALL = CorridorConfig(
    floor=FloorConfig(texel_m=0.02),
    robot=RobotConfig(distance_m=1.0, step_m=0.5, turn_step_deg=90.0),
    camera=CameraConfig(width=80),
)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    out = tmp_path_factory.mktemp("world") / "run"
    render_sequence(SMALL, out)
    return out


@pytest.fixture(scope="module")
def recording():
    return record(SMALL)


def test_written_run_reads_back(written, recording):
    read = read_sequence(written, depth=True)
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
    files = sorted(p.relative_to(written) for p in written.rglob("*") if p.is_file())
    assert len(files) == 2 * 8 + 6
    assert all((written / f).read_bytes() == (out / f).read_bytes() for f in files)


def test_a_rolling_shutter_skews_what_the_robot_turns_past(recording):
    rolling = record(replace(SMALL, sensor=SensorConfig(readout_s=0.1)))
    turns = int(np.argmax(np.abs(np.diff(recording.world_from_base[:, 0, 0])))) + 1
    (still, _), (skewed, _) = (run.frame(turns) for run in (recording, rolling))
    differs = np.abs(still.astype(int) - skewed).mean(axis=(1, 2))
    assert differs[[0, -1]].min() > 3 * differs[len(differs) // 2] and differs.max() > 3
    assert np.all(rolling.world_from_base == recording.world_from_base)


def test_moments_lie_around_the_frame_and_reach_over_the_readout():
    config = replace(SMALL, sensor=SensorConfig(readout_s=0.05, shutter_s=0.02))
    poses = np.stack([np.arange(5.0), np.zeros(5), 0.2 * np.arange(5)], axis=1)
    at = moments(poses, 2, 61, config)
    assert at.shape == (3, 61, 3)
    np.testing.assert_allclose(at[1, 30], poses[2])
    np.testing.assert_allclose(at[1, -1] - at[1, 0], [0.1, 0, 0.02])
    np.testing.assert_allclose(at[2, 5] - at[0, 5], [0.04, 0, 0.008])
    assert np.all(moments(poses, 2, 61, SMALL) == poses[2])


def test_on_a_ramp_the_truth_climbs_and_pitches(tmp_path):
    config = replace(SMALL, plan=PlanConfig(ramp="0.3 0, 0.8 0", ramp_deg=10.0))
    run, level = record(config), record(SMALL)
    top = 0.5 * np.tan(np.radians(10))
    np.testing.assert_allclose(run.world_from_base[[0, 2], 2, 3], [0, top], atol=1e-9)
    assert run.world_from_base[1, 2, 0] > 0.1 and np.all(run.odom_from_base[:, 2, 3] == 0)
    np.testing.assert_allclose(run.world_from_base[:, :2, 3], level.world_from_base[:, :2, 3])
    assert np.hypot(*run.odom_from_base[2, :2, 3]) > np.hypot(*level.odom_from_base[2, :2, 3]) + 0.004
    assert np.abs(run.frame(0)[0].astype(int) - level.frame(0)[0]).mean() > 3


def test_another_seed_is_another_run(recording):
    other = record(replace(SMALL, seed=1))
    assert np.abs(other.frame(0)[0].astype(int) - recording.frame(0)[0]).mean() > 3
    assert np.abs(other.odom_from_base - recording.odom_from_base).max() > 0.001


def test_frames_are_float32_whatever_the_default(recording):
    assert {leaf.dtype for leaf in jax.tree.leaves(recording.camera)} == {np.dtype(np.float32)}


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


def test_everything_at_once_is_a_function_of_the_seed():
    config = replace(
        SMALL,
        sun=1.0,
        landmarks_per_m=0.5,
        plan=PlanConfig(corridors=("0 0, 3 0, 3 3", "3 1.5, 6 1.5")),
        robot=replace(SMALL.robot, route="0 0, 3 0, 3 3", stops=1),
        passers=PassersConfig(share=0.9),
        sensor=SensorConfig(shutter_s=0.02),
    )
    one, two = record(config), record(config)
    for i in range(0, len(one), 5):
        for a, b in zip(one.frame(i), two.frame(i), strict=True):
            assert np.all(a == b)
    bare = record(replace(config, passers=PassersConfig(), landmarks_per_m=0.0))
    nearer = [np.mean(one.frame(i)[1].astype(int) < bare.frame(i)[1].astype(int) - 300) for i in range(0, len(one), 3)]
    assert max(nearer) > 0.05, "somebody stands in the way"


@pytest.mark.parametrize(
    "config, key",
    [
        (replace(SMALL, plan=PlanConfig(width_m=-1.0)), "plan.width_m"),
        (replace(SMALL, plan=PlanConfig(width_m=0.5)), "plan.width_m"),
        (replace(SMALL, plan=PlanConfig(margin_m=0.1)), "plan.margin_m"),
        (replace(SMALL, plan=PlanConfig(corridors=("0 0",))), r"plan.corridors\[0\]"),
        (replace(SMALL, plan=PlanConfig(corridors=("0 5, 1 5",))), "robot.route"),
        (replace(SMALL, gloss=2.0), "gloss"),
        (replace(SMALL, camera=replace(SMALL.camera, width=0)), "camera.width"),
        (replace(SMALL, camera=replace(SMALL.camera, height_m=3.0)), "camera.height_m"),
        (replace(SMALL, robot=replace(SMALL.robot, step_m=float("nan"))), "robot.step_m"),
        (replace(SMALL, passers=PassersConfig(share=1.5)), "passers.share"),
        (replace(SMALL, sensor=SensorConfig(shutter_s=-1.0)), "sensor.shutter_s"),
        (replace(SMALL, sensor=SensorConfig(readout_s=-1.0)), "sensor.readout_s"),
        (replace(SMALL, sensor=SensorConfig(readout_s=0.6)), "sensor.readout_s"),
        (replace(SMALL, plan=PlanConfig(ramp="1 0", ramp_deg=5.0)), "plan.ramp"),
        (replace(SMALL, plan=PlanConfig(ramp="0 0, 1 0", ramp_deg=25.0)), "plan.ramp_deg"),
        (
            replace(
                SMALL, plan=PlanConfig(ramp="0.1 0, 0.8 0", ramp_deg=9.0), camera=replace(SMALL.camera, height_m=0.02)
            ),
            "plan.ramp_deg",
        ),
    ],
)
def test_bad_values_name_their_key_and_write_nothing(config, key, tmp_path):
    with pytest.raises(ValueError, match=f"^{key} is"):
        render_sequence(config, tmp_path / "run")
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


@pytest.mark.parametrize("path", sorted(WORLDS.glob("*.yaml")), ids=lambda path: path.stem)
def test_worlds_keep_the_robot_inside(path):
    config = load_config(path, Config)
    check(config)
    poses, _ = drive(config.robot, np.random.default_rng(config.seed))
    check_inside(config, plan_of(config), poses)
    assert 100 <= len(poses) <= 500
