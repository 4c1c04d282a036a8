from dataclasses import replace

import jax
import numpy as np
import pytest

from ebjax.floors.__main__ import Config, main, render_sequence
from ebjax.floors.robot import RobotConfig
from ebjax.floors.sequence import CameraConfig, CorridorConfig, record
from ebjax.floors.tiles import TileConfig
from ebjax.io.sequence import read_sequence

SMALL = CorridorConfig(
    floor=TileConfig(texel_m=0.02),
    robot=RobotConfig(distance_m=1.0, step_m=0.5, turn_step_deg=90.0),
    camera=CameraConfig(focal_px=76.8, width=80, height=60),
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
    run = read_sequence(written, depth=True)
    assert len(run) == len(recording) == 7 and run.dropped == ()
    np.testing.assert_allclose(run.world_from_base, recording.world_from_base, atol=1e-6)
    np.testing.assert_allclose(run.odom_from_base, recording.odom_from_base, atol=1e-6)
    np.testing.assert_allclose(run.camera.base_from_camera, recording.camera.base_from_camera, atol=1e-6)
    rgb, depth = recording.frame(3)
    assert np.abs(run.rgb(3).astype(int) - rgb).mean() < 6
    np.testing.assert_allclose(run.depth(3), depth / 1000, atol=1e-6)


def test_the_command_writes_the_same_files_for_the_same_seed(written, tmp_path, capsys):
    out = tmp_path / "again"
    main(Config(floor=SMALL.floor, robot=SMALL.robot, camera=SMALL.camera, out=out))
    assert str(out) in capsys.readouterr().out
    files = sorted(p.relative_to(written) for p in written.rglob("*") if p.is_file())
    assert len(files) == 2 * 7 + 5
    assert all((written / f).read_bytes() == (out / f).read_bytes() for f in files)


def test_another_seed_is_another_run(recording):
    other = record(replace(SMALL, seed=1))
    assert np.abs(other.frame(0)[0].astype(int) - recording.frame(0)[0]).mean() > 3
    assert np.abs(other.odom_from_base - recording.odom_from_base).max() > 0.001


def test_frames_are_float32_whatever_the_default(recording):
    assert {leaf.dtype for leaf in jax.tree.leaves(recording.camera)} == {np.dtype(np.float32)}


@pytest.mark.parametrize(
    "config, key",
    [
        (replace(SMALL, width_m=-1.0), "width_m"),
        (replace(SMALL, width_m=0.5), "width_m"),
        (replace(SMALL, margin_m=0.1), "margin_m"),
        (replace(SMALL, gloss=2.0), "gloss"),
        (replace(SMALL, camera=replace(SMALL.camera, width=0)), "camera.width"),
        (replace(SMALL, robot=replace(SMALL.robot, step_m=float("nan"))), "robot.step_m"),
    ],
)
def test_bad_values_name_their_key_and_write_nothing(config, key, tmp_path):
    with pytest.raises(ValueError, match=f"^{key} is"):
        render_sequence(config, tmp_path / "run")
    assert not list(tmp_path.iterdir())
