import shutil

import cv2
import numpy as np

from ebjax.io.camera_file import CameraFile, write_camera
from ebjax.io.frames import Frames
from ebjax.io.logs.open import LogOptions, Topics
from ebjax.mapping.open_run import open_run
from ebjax.train.own_run import OwnRun, log_flags

LEVEL = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0.5], [0, 0, 0, 1]])


def test_frames_that_cannot_be_read_are_told(tmp_path):
    for k in range(4):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.full((48, 64, 3), 50 * k, np.uint8))
    (tmp_path / "rgb.txt").write_text("".join(f"{k} {k}.png\n" for k in range(4)))
    k = np.array([[60.0, 0, 31.5], [0, 60, 23.5], [0, 0, 1]])
    write_camera(tmp_path / "camera.json", CameraFile(k, LEVEL, 64, 48, 1000.0))
    (tmp_path / "1.png").write_bytes(b"no image")
    frames = Frames(open_run(OwnRun(sequence=tmp_path)))
    assert frames.both(0)[1] is None and frames.rgb(1) is None and frames.both(1) is None
    assert frames.told().startswith("1 frames could not be read, first") and "1.png" in frames.told()
    shutil.copy(tmp_path / "0.png", tmp_path / "1.png")
    again = Frames(open_run(OwnRun(sequence=tmp_path)))
    assert again.rgb(1) is not None and again.told() == ""


def test_flags_that_read_the_same_log_again():
    assert log_flags(OwnRun()) == ""
    options = LogOptions(topics=Topics(image="/camera/image raw"), session=2, frames_per_s=5.0)
    assert log_flags(OwnRun(log=options)) == " --topics.image '/camera/image raw' --session 2 --frames-per-s 5.0"
