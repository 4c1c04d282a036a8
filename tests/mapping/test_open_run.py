import cv2
import numpy as np
import pytest

from ebjax.io.camera_file import CameraFile, write_camera
from ebjax.io.frames import Frames
from ebjax.io.logs.mount_options import MountOptions
from ebjax.io.logs.open import LogOptions, Topics
from ebjax.mapping.open_run import RunOptions, camera_source, open_run, recording_of
from ebjax.mapping.seen_floor import FloorOptions, camera_over_floor, ignored_pixels, run_view, view_chooser

LEVEL = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0.5], [0, 0, 0, 1]])
DOWN = MountOptions(height_m=0.7, pitch_deg=40.0)


@pytest.fixture
def folder(tmp_path):
    """Six small images, each of another grey, with odometry and a level camera."""
    run = tmp_path / "run"
    (run / "rgb").mkdir(parents=True)
    for k in range(6):
        cv2.imwrite(str(run / "rgb" / f"{k}.png"), np.full((48, 64, 3), 40 * k, np.uint8))
    (run / "rgb.txt").write_text("".join(f"{k} rgb/{k}.png\n" for k in range(6)))
    (run / "odometry.txt").write_text("".join(f"{k} {0.1 * k} 0 0 0 0 0 1\n" for k in range(6)))
    k = np.array([[60.0, 0, 31.5], [0, 60, 23.5], [0, 0, 1]])
    write_camera(run / "camera.json", CameraFile(k, LEVEL, 64, 48, 1000.0))
    return run


def test_a_run_with_another_mount(folder):
    options = RunOptions(sequence=folder, mount=MountOptions(height_m=0.7, pitch_deg=20.0))
    sequence = open_run(options)
    assert len(sequence) == 6
    assert sequence.camera.base_from_camera[2, 3] == pytest.approx(0.7)
    assert sequence.camera.base_from_camera[2, 2] == pytest.approx(-np.sin(np.radians(20)))
    assert "camera.json" in camera_source(options, sequence)
    other = folder.parent / "other.json"
    assert camera_source(RunOptions(sequence=folder, camera=other), sequence) == str(other)


def test_a_run_must_be_named():
    with pytest.raises(ValueError, match="sequence is not set: name a run with --sequence"):
        open_run(RunOptions())


def test_what_another_kind_of_log_would_need_is_refused(folder):
    with pytest.raises(ValueError, match=r"--topics\.\* is for ROS bags; leave it out here"):
        open_run(RunOptions(sequence=folder, log=LogOptions(topics=Topics(image="/a"))))


def test_the_remedy_for_missing_odometry_works(folder):
    lines = (folder / "odometry.txt").read_text().splitlines()[:2]
    (folder / "odometry.txt").write_text("\n".join(lines) + "\n")
    with pytest.raises(ValueError, match="--min-coverage lower"):
        open_run(RunOptions(sequence=folder))
    assert len(open_run(RunOptions(sequence=folder, min_coverage=0.3))) == 2
    assert len(open_run(RunOptions(sequence=folder), odometry=False)) == 6


def test_the_engine_gets_what_the_log_has(folder):
    sequence = open_run(RunOptions(sequence=folder, time_offset_s=0.5, min_coverage=0.8))
    np.testing.assert_allclose(sequence.timestamps[:2], [0.5, 1.5])
    given = recording_of(sequence, Frames(sequence), timed=True)
    assert len(given) == 5 and given.names == tuple(f"rgb/{k}.png" for k in range(5))
    np.testing.assert_allclose(given.odom_from_base[:2, 0], [0.05, 0.15], atol=1e-9)
    np.testing.assert_allclose(given.odometry_at(0.0)[:2, 0], [0.0, 0.1], atol=1e-9)
    assert given.load(1)[0].shape == (48, 64, 3) and given.load(1)[1] is None
    assert recording_of(sequence, Frames(sequence)).odometry_at is None
    (folder / "odometry.txt").unlink()
    without = open_run(RunOptions(sequence=folder))
    given = recording_of(without, Frames(without), timed=True)
    assert given.odom_from_base is None and given.odometry_at is None and given.level_at(0.0) is None


def test_what_is_no_floor_is_ignored_and_told(folder):
    sequence = open_run(RunOptions(sequence=folder, mount=DOWN))
    assert ignored_pixels("auto", sequence) == ignored_pixels("none", sequence) == (None, ())
    for k in range(6):
        image = np.full((48, 64, 4), 40 * k, np.uint8)
        image[..., 3] = 255
        image[:12, :10, 3] = 0
        cv2.imwrite(str(folder / "rgb" / f"{k}.png"), image)
    found, notes = ignored_pixels("auto", sequence)
    assert found is not None and found[2, 2] and not found[40, 40]
    assert "4% of the image is transparent and ignored" in notes[0]
    given = np.full((48, 64), 255, np.uint8)
    given[30:] = 0
    cv2.imwrite(str(folder / "mask.png"), given)
    from_file, _ = ignored_pixels(folder / "mask.png", sequence)
    assert from_file[40].all() and not from_file[10].any()
    options = FloorOptions(view=(0.4, 1.2, -0.3, 0.3))
    camera, _ = camera_over_floor(options, sequence)
    whole, masked = (run_view(options, one, camera) for one in (None, from_file))
    assert np.asarray(masked.seen).sum() < np.asarray(whole.seen).sum()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (FloorOptions(view=(3.0, 1.0, -1.0, 1.0)), ["camera.json", "x_min"]),
        (FloorOptions(quad=(1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 4.0, 4.0)), ["camera.json", "clockwise"]),
    ],
)
def test_a_floor_that_cannot_be_looked_at_is_refused(folder, options, words):
    sequence = open_run(RunOptions(sequence=folder, mount=DOWN))
    camera, _ = camera_over_floor(options, sequence)
    with pytest.raises(ValueError) as refused:
        view_chooser(options, None, camera, str(sequence.log.camera_source))
    assert all(word in str(refused.value) for word in words), refused.value


def test_the_floor_from_depth_needs_depth(folder):
    sequence = open_run(RunOptions(sequence=folder))
    with pytest.raises(ValueError, match="--floor depth needs a log with depth"):
        camera_over_floor(FloorOptions(floor="depth"), sequence)
