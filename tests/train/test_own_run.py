import shutil

import cv2
import numpy as np
import pytest

from ebjax.io.camera_file import CameraFile, write_camera
from ebjax.io.frames import Frames
from ebjax.io.logs.mount_options import MountOptions
from ebjax.io.logs.open import LogOptions, Topics
from ebjax.train.own_run import OwnRun, log_flags, open_run

LEVEL = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0.5], [0, 0, 0, 1]])


@pytest.fixture
def folder(tmp_path):
    """Four small images with odometry and a camera."""
    run = tmp_path / "run"
    (run / "rgb").mkdir(parents=True)
    for k in range(4):
        cv2.imwrite(str(run / "rgb" / f"{k}.png"), np.full((48, 64, 3), 50 * k, np.uint8))
    (run / "rgb.txt").write_text("".join(f"{k} rgb/{k}.png\n" for k in range(4)))
    (run / "odometry.txt").write_text("".join(f"{k} {0.1 * k} 0 0 0 0 0 1\n" for k in range(4)))
    k = np.array([[60.0, 0, 31.5], [0, 60, 23.5], [0, 0, 1]])
    write_camera(run / "camera.json", CameraFile(k, LEVEL, 64, 48, 1000.0))
    return run


def test_a_run_with_another_mount(folder):
    sequence = open_run(OwnRun(sequence=folder, mount=MountOptions(height_m=0.7, pitch_deg=20.0)))
    assert len(sequence) == 4
    assert sequence.camera.base_from_camera[2, 3] == pytest.approx(0.7)
    assert sequence.camera.base_from_camera[2, 2] == pytest.approx(-np.sin(np.radians(20)))


def test_a_run_must_be_named():
    with pytest.raises(ValueError, match="sequence is not set: name a run with --sequence"):
        open_run(OwnRun())


def test_what_another_kind_of_log_would_need_is_refused(folder):
    with pytest.raises(ValueError, match=r"--topics\.\* is for ROS bags; leave it out here"):
        open_run(OwnRun(sequence=folder, log=LogOptions(topics=Topics(image="/a"))))


def test_the_remedy_for_missing_odometry_works(folder):
    lines = (folder / "odometry.txt").read_text().splitlines()[:2]
    (folder / "odometry.txt").write_text("\n".join(lines) + "\n")
    with pytest.raises(ValueError, match="--min-coverage lower"):
        open_run(OwnRun(sequence=folder))
    assert len(open_run(OwnRun(sequence=folder, min_coverage=0.4))) == 2


def test_frames_that_cannot_be_read_are_told(folder):
    (folder / "rgb" / "1.png").write_bytes(b"no image")
    frames = Frames(open_run(OwnRun(sequence=folder)))
    assert frames.both(0)[1] is None and frames.rgb(1) is None and frames.both(1) is None
    assert frames.told().startswith("1 frames could not be read, first") and "1.png" in frames.told()
    shutil.copy(folder / "rgb" / "0.png", folder / "rgb" / "1.png")
    again = Frames(open_run(OwnRun(sequence=folder)))
    assert again.rgb(1) is not None and again.told() == ""


def test_flags_that_read_the_same_log_again():
    assert log_flags(OwnRun()) == ""
    options = LogOptions(topics=Topics(image="/camera/image raw"), session=2, frames_per_s=5.0)
    assert log_flags(OwnRun(log=options)) == " --topics.image '/camera/image raw' --session 2 --frames-per-s 5.0"
