import dataclasses
import json
import shutil

import cv2
import numpy as np
import pytest

from ebjax.geometry.camera import camera_over_floor
from ebjax.io.camera_file import CameraFile, read_camera
from ebjax.io.write_sequence import write_sequence
from ebjax.slam.world import matrices
from ebjax.train.calibrate import Config, run

OFF = Config(depth="none", pitch_off_deg=3.0, roll_off_deg=1.0, height_off_m=0.05, pairs=48)


CAMERA = camera_over_floor(308.0, 308.0, 157.0, 123.0, 320, 240, 0.54, np.radians(19.0), x_m=0.27)
WAY = np.stack([0.15 * np.arange(26), 0.1 * np.sin(0.2 * np.arange(26)), 0.12 * np.cos(0.2 * np.arange(26))], 1)


def stains():
    """A floor of 8 x 4 m, 5 mm a texel, blotches of all sizes."""
    rng = np.random.default_rng(0)
    floor = np.zeros((800, 1600), np.float32)
    for size in (2, 4, 8, 16, 64):
        blotches = rng.normal(size=(800 // size, 1600 // size)).astype(np.float32)
        floor += cv2.resize(blotches, (1600, 800), interpolation=cv2.INTER_CUBIC)
    return floor


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """A small camera driven over an endless floor, its odometry perfect."""
    out, floor = tmp_path_factory.mktemp("driven") / "sequence", stains()
    pose, k = np.asarray(CAMERA.base_from_camera), np.asarray(CAMERA.intrinsics)
    v, u = np.mgrid[:240, :320]
    rays = np.stack([u, v, np.ones_like(u)], -1) @ (pose[:3, :3] @ np.linalg.inv(k)).T
    depth = np.where(rays[..., 2] < -0.05, -pose[2, 3] / np.minimum(rays[..., 2], -0.05), 0.0)
    base = rays[..., :2] * depth[..., None] + pose[:2, 3]

    def frame(i):
        x, y, heading = WAY[i]
        c, s = np.cos(heading), np.sin(heading)
        at_x, at_y = x + c * base[..., 0] - s * base[..., 1], y + s * base[..., 0] + c * base[..., 1]
        seen = cv2.remap(floor, *np.float32([at_x / 0.005, 400 + at_y / 0.005]), cv2.INTER_LINEAR)
        grey = np.where(depth > 0, np.clip(120 + 30 * seen, 0, 255), 0).astype(np.uint8)
        return np.repeat(grey[..., None], 3, 2), (1000 * depth).astype(np.uint16)

    poses = matrices(WAY)
    camera = CameraFile(k, pose, 320, 240, 1000.0)
    write_sequence(out, 0.2 * np.arange(len(WAY)), poses, poses, camera, frame, threads=1)
    return out


@pytest.fixture
def sequence(driven, tmp_path):
    """A copy that a test may spoil."""
    return shutil.copytree(driven, tmp_path / "sequence")


def numbers(out):
    report = json.loads((out / "calibration.json").read_text())
    return report, {name: entry["found"] - entry["given"] for name, entry in report["mount"].items()}


def test_recovers_a_camera_that_was_set_wrong(driven, tmp_path, capsys):
    run(dataclasses.replace(OFF, sequence=driven), tmp_path / "out", resume=False)
    report, error = numbers(tmp_path / "out")
    assert abs(error["pitch_deg"]) < 0.1
    assert abs(error["roll_deg"]) < 0.1
    assert abs(error["height_m"]) < 0.003
    assert report["floor_error_m"] < 0.01 < report["floor_moved_m"]
    assert {entry["known"] for entry in list(report["mount"].values())[:4]} == {"by the run"}
    assert "pitch_deg" in capsys.readouterr().out
    true, found = read_camera(driven / "camera.json"), read_camera(tmp_path / "out" / "camera.json")
    np.testing.assert_allclose(found.base_from_camera, true.base_from_camera, atol=0.005)
    np.testing.assert_array_equal(found.intrinsics, true.intrinsics)


def test_starts_from_depth_where_there_is_any(driven, tmp_path, capsys):
    run(dataclasses.replace(OFF, sequence=driven, depth="sequence"), tmp_path / "out", resume=False)
    report, error = numbers(tmp_path / "out")
    assert report["start"] == "plane fitted to depth"
    assert abs(report["mount"]["pitch_deg"]["start"] - report["mount"]["pitch_deg"]["given"]) < 0.2
    assert abs(error["pitch_deg"]) < 0.1
    assert "start: plane fitted to depth" in capsys.readouterr().out


def test_a_run_that_stands_still_is_refused(sequence, tmp_path):
    lines = (sequence / "odometry.txt").read_text().splitlines()
    still = [f"{line.split()[0]} 0 0 0 0 0 0 1" for line in lines if not line.startswith("#")]
    (sequence / "odometry.txt").write_text("\n".join(still) + "\n")
    with pytest.raises(ValueError, match="pairs of frames"):
        run(dataclasses.replace(OFF, sequence=sequence), tmp_path / "out", resume=False)
    assert not (tmp_path / "out").exists()


def test_odometry_of_another_run_is_refused(sequence, tmp_path):
    heading = 0.1 * np.arange(len(WAY))
    x, y = np.cumsum(0.15 * np.cos(heading)), np.cumsum(0.15 * np.sin(heading))
    zero = np.zeros_like(x)
    rows = np.stack([0.2 * np.arange(len(x)), x, y, zero, zero, zero, np.sin(heading / 2), np.cos(heading / 2)], 1)
    np.savetxt(sequence / "odometry.txt", rows, fmt="%.6f")
    with pytest.raises(ValueError, match="agree with odometry"):
        run(dataclasses.replace(OFF, sequence=sequence), tmp_path / "out", resume=False)
