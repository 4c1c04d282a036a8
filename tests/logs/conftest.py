"""Small logs to describe and to write in another form."""

import importlib
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from ebjax.io.camera_file import CameraFile, write_camera
from ebjax.io.trajectory import write_tum

MOUNT = np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 0.5], [0, 0, 0, 1]])


@pytest.fixture
def bags():
    """The writer of small bags."""
    pytest.importorskip("rosbags.highlevel")
    pytest.importorskip("rosbags.image")
    sys.path.insert(0, str(Path(__file__).parents[1] / "io" / "logs"))
    return importlib.import_module("bag_writer")


@pytest.fixture
def bag(bags, tmp_path):
    """A bag of 8 images with depth, odometry and tf; the camera looks ahead, 0.5 m above the floor."""
    with bags.BagWriter(tmp_path, "ros1") as writer:
        bags.write_run(writer)
    return writer.path


@pytest.fixture
def folder(tmp_path):
    """Six JPEGs in TUM layout, with a camera and odometry."""
    path, stamps = tmp_path / "folder", 100 + np.arange(6) / 5
    (path / "rgb").mkdir(parents=True)
    for k, stamp in enumerate(stamps):
        cv2.imwrite(str(path / "rgb" / f"{stamp:.6f}.jpg"), np.full((24, 32, 3), 40 * k, np.uint8))
    (path / "rgb.txt").write_text("".join(f"{stamp:.6f} rgb/{stamp:.6f}.jpg\n" for stamp in stamps))
    k = np.array([[30.0, 0, 16], [0, 30.0, 12], [0, 0, 1]])
    write_camera(path / "camera.json", CameraFile(k, MOUNT, 32, 24, 1000.0))
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[:, 0, 3] = np.arange(6) * 0.5
    write_tum(path / "odometry.txt", stamps, poses)
    return path
