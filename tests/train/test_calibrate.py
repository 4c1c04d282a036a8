import dataclasses
import json
import shutil

import cv2
import numpy as np
import pytest

from ebjax.command import run as run_command
from ebjax.geometry.camera import camera_from, camera_over_floor, project, raw_from_ideal, rays_of
from ebjax.geometry.lens import lens
from ebjax.io.camera_file import CameraFile, read_camera
from ebjax.io.write_bag import write_bag
from ebjax.io.write_sequence import write_sequence
from ebjax.slam.world import matrices
from ebjax.train.__main__ import command, main
from ebjax.train.calibrate import Config, run

OFF = Config(depth="none", pitch_off_deg=3.0, roll_off_deg=1.0, height_off_m=0.05, pairs=48)


CAMERA = camera_over_floor(308.0, 308.0, 157.0, 123.0, 320, 240, 0.54, np.radians(19.0), x_m=0.27)
LENS = lens("plumb_bob", [-0.25, 0.08, 0.0, 0.0, 0.0])
WAY = np.stack([0.15 * np.arange(26), 0.1 * np.sin(0.2 * np.arange(26)), 0.12 * np.cos(0.2 * np.arange(26))], 1)


def stains():
    """A floor of 8 x 4 m, 5 mm a texel, blotches of all sizes."""
    rng = np.random.default_rng(0)
    floor = np.zeros((800, 1600), np.float32)
    for size in (2, 4, 8, 16, 64):
        blotches = rng.normal(size=(800 // size, 1600 // size)).astype(np.float32)
        floor += cv2.resize(blotches, (1600, 800), interpolation=cv2.INTER_CUBIC)
    return floor


def drive(out, seen_by):
    """A small camera driven over an endless floor, its odometry perfect."""
    floor, pose = stains(), np.asarray(seen_by.base_from_camera)
    v, u = np.mgrid[:240, :320]
    rays, _ = rays_of(seen_by, np.stack([u, v], -1).reshape(-1, 2).astype(float))
    rays = np.asarray(rays)
    rays = (rays / rays[:, 2:]).reshape(240, 320, 3) @ pose[:3, :3].T
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
    bent = seen_by.lens.model, tuple(np.asarray(seen_by.lens.coefficients).tolist())
    camera = CameraFile(np.asarray(seen_by.intrinsics), pose, 320, 240, 1000.0, *bent)
    write_sequence(out, 0.2 * np.arange(len(WAY)), poses, poses, camera, frame, threads=1)
    return out


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """The drive of a pinhole."""
    return drive(tmp_path_factory.mktemp("driven") / "sequence", CAMERA)


@pytest.fixture(scope="module")
def bent(tmp_path_factory):
    """The drive of a camera whose lens bends."""
    return drive(tmp_path_factory.mktemp("bent") / "sequence", dataclasses.replace(CAMERA, lens=LENS))


@pytest.fixture
def sequence(driven, tmp_path):
    """A copy that a test may spoil."""
    return shutil.copytree(driven, tmp_path / "sequence")


def numbers(out):
    report = json.loads((out / "calibration.json").read_text())
    return report, {name: entry["found"] - entry["given"] for name, entry in report["mount"].items()}


@pytest.mark.slow
def test_recovers_a_camera_that_was_set_wrong(driven, tmp_path, capsys):
    run(dataclasses.replace(OFF, sequence=driven), tmp_path / "out", resume=False)
    report, error = numbers(tmp_path / "out")
    assert abs(error["pitch_deg"]) < 0.1
    assert abs(error["roll_deg"]) < 0.1
    assert abs(error["height_m"]) < 0.003
    assert report["floor_error_m"] < 0.01 < report["floor_moved_m"]
    assert {entry["known"] for entry in list(report["mount"].values())[:4]} == {"by the run"}
    assert report["floor_error_before_m"] > 0.05 and "lens" not in report
    assert "pitch_deg" in capsys.readouterr().out
    true, found = read_camera(driven / "camera.json"), read_camera(tmp_path / "out" / "camera.json")
    np.testing.assert_allclose(found.base_from_camera, true.base_from_camera, atol=0.005)
    np.testing.assert_array_equal(found.intrinsics, true.intrinsics)


@pytest.mark.slow
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


def image_error_px(file):
    """How far a camera's image of the floor is from that of the camera that was driven, px at most."""
    floor = np.random.default_rng(0).uniform([1.0, -0.4, 0], [2.2, 0.4, 1e-9], (200, 3))
    true = dataclasses.replace(CAMERA, lens=LENS)
    images = [raw_from_ideal(one, project(one, floor)[0]) for one in (true, camera_from(read_camera(file)))]
    return float(np.linalg.norm(images[0] - images[1], axis=1).max())


@pytest.mark.slow
def test_recovers_a_lens_that_was_set_wrong(bent, tmp_path, capsys):
    config = Config(sequence=bent, depth="none", k1_off=0.4, lens="distortion", pairs=48)
    run(config, tmp_path / "out", resume=False)
    report, error = numbers(tmp_path / "out")
    k1 = report["lens"]["k1"]
    assert (k1["given"], k1["start"], k1["known"]) == (-0.25, -0.35, "by the run")
    assert abs(k1["found"] + 0.25) < 0.02 and k1["sigma"] < k1["sigma_before"] / 2
    assert report["lens"]["fx_px"]["known"] == "kept" and abs(error["pitch_deg"]) < 0.1
    assert report["floor_error_m"] < report["floor_error_before_m"] / 3
    assert report["residual_median_px"] < report["residual_median_px_by_the_mount_alone"]
    assert image_error_px(tmp_path / "out" / "camera.json") < 1.0
    assert " -0.25000  -0.35000 " in capsys.readouterr().out


@pytest.mark.slow
def test_finds_a_lens_of_which_nothing_was_said(bent, tmp_path):
    camera = tmp_path / "camera.yaml"
    camera.write_text(
        "image_width: 320\nimage_height: 240\ncamera_name: own\ncamera_matrix: {rows: 3, cols: 3, "
        "data: [308, 0, 157, 0, 308, 123, 0, 0, 1]}\ndistortion_model: plumb_bob\n"
        "distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n"
    )
    shutil.copytree(bent, tmp_path / "run")
    (tmp_path / "run" / "camera.json").unlink()
    argv = ["--task", "calibrate", "--sequence", str(tmp_path / "run"), "--camera", str(camera), "--depth", "none"]
    mount = ["--mount.height-m", "0.54", "--mount.pitch-deg", "19", "--mount.x-m", "0.27"]
    flags = [*argv, *mount, "--lens", "distortion", "--pairs", "48", "--distortion-sigma", "0.05"]
    run_command(main, command("calibrate"), [*flags, "--out", str(tmp_path / "out")])
    found = read_camera(tmp_path / "out" / "camera.json")
    assert found.distortion_model == "plumb_bob" and len(found.distortion) == 5
    assert image_error_px(tmp_path / "out" / "camera.json") < 1.0
    report = json.loads((tmp_path / "out" / "calibration.json").read_text())
    assert report["start"] == f"{camera}, a plumb_bob lens that bends nothing"


@pytest.mark.slow
def test_a_bag_is_as_good_as_its_folder(driven, tmp_path, capsys):
    pytest.importorskip("rosbags")
    bag = tmp_path / "run.mcap"
    write_bag(bag, driven, "mcap")
    run(dataclasses.replace(OFF, sequence=bag), tmp_path / "out", resume=False)
    _, error = numbers(tmp_path / "out")
    assert abs(error["pitch_deg"]) < 0.1 and abs(error["height_m"]) < 0.003
    assert f"use it: python -m ebjax.slam {bag} --camera" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"pitch_sigma_deg": -1.0}, "pitch_sigma_deg is -1.0: needs a number from 0"),
        ({"focal_sigma": 0.1}, "focal_sigma is 0.1, but lens is none: set --lens intrinsics"),
        ({"distortion_sigma": 0.1, "lens": "intrinsics"}, "lens is intrinsics: set --lens distortion"),
        ({"k1_off": 0.2, "lens": "distortion"}, "camera.json says no lens with a k1"),
    ],
)
def test_what_cannot_be_is_refused(driven, tmp_path, changes, words):
    with pytest.raises(ValueError, match=words):
        run(Config(sequence=driven, depth="none", **changes), tmp_path / "out", resume=False)
    assert not (tmp_path / "out").exists()


def test_a_log_without_odometry_is_refused_by_its_name(sequence, tmp_path):
    (sequence / "odometry.txt").unlink()
    with pytest.raises(ValueError, match=f"{sequence}: calibration needs odometry"):
        run(Config(sequence=sequence, depth="none"), tmp_path / "out", resume=False)


def test_a_camera_that_sees_no_floor_is_named(driven, tmp_path):
    level = json.loads((driven / "camera.json").read_text())
    level["T_base_camera"] = [[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 40.0], [0, 0, 0, 1]]
    (tmp_path / "high.json").write_text(json.dumps(level))
    with pytest.raises(ValueError, match=r"high\.json: the camera sees"):
        run(Config(sequence=driven, camera=tmp_path / "high.json", depth="none"), tmp_path / "out", resume=False)
