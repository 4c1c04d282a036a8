import dataclasses
import json

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ebjax.geometry.camera import camera_from, camera_over_floor, raw_from_ideal
from ebjax.io.camera_file import CameraFile
from ebjax.io.nerfstudio import write_transforms

WITHOUT = CameraFile(
    np.array([[617.19, 0, 314.65], [0, 615.0, 246.58], [0, 0, 1]]),
    np.asarray(camera_over_floor(617.19, 615.0, 314.65, 246.58, 640, 480, 0.54, 0.33, 0.02, 0.27).base_from_camera),
    640,
    480,
    1000.0,
)
BROWN = (0.12, -0.21, 0.001, -0.002)
LENSES = {
    "none": ("pinhole", ()),
    "four": ("plumb_bob", BROWN),
    "five": ("plumb_bob", (*BROWN, 0.05)),
    "eight with zeros": ("rational_polynomial", (*BROWN, 0.05, 0.0, 0.0, 0.0)),
    "fisheye": ("equidistant", (0.02, -0.004, 0.001, -0.0003)),
}


def with_lens(model, coefficients):
    return dataclasses.replace(WITHOUT, distortion_model=model, distortion=coefficients)


def poses(count=5, seed=0):
    draw = np.random.default_rng(seed)
    found = np.tile(np.eye(4), (count, 1, 1))
    found[:, :3, :3] = Rotation.from_rotvec(draw.uniform(-np.pi, np.pi, (count, 1)) * [0, 0, 1]).as_matrix()
    found[:, :2, 3] = draw.uniform(-5, 5, (count, 2))
    return found


def nerfstudio_pixels(values, frame, points):
    """As nerfstudio and OpenCV read the file: axes by OpenGL, pixels half a pixel off OpenCV's."""
    world_from_camera = np.array(frame["transform_matrix"]) @ np.diag([1, -1, -1, 1])
    camera_from_world = np.linalg.inv(world_from_camera)
    intrinsics = np.array([[values["fl_x"], 0, values["cx"] - 0.5], [0, values["fl_y"], values["cy"] - 0.5], [0, 0, 1]])
    turn, shift = cv2.Rodrigues(camera_from_world[:3, :3])[0], camera_from_world[:3, 3].copy()
    if values["camera_model"] == "OPENCV_FISHEYE":
        k = np.array([values[f"k{n}"] for n in range(1, 5)])
        return cv2.fisheye.projectPoints(points[:, None], turn, shift[:, None], intrinsics, k)[0][:, 0]
    assert values["camera_model"] == "OPENCV"
    k = np.array([values[name] for name in ("k1", "k2", "p1", "p2", "k3")])
    return cv2.projectPoints(points, turn, shift, intrinsics, k)[0][:, 0]


@pytest.mark.parametrize("lens", LENSES)
def test_a_point_of_the_floor_falls_on_the_same_pixel(tmp_path, lens):
    camera, where = with_lens(*LENSES[lens]), poses()
    write_transforms(tmp_path / "transforms.json", camera, where, [f"rgb/{k}.jpg" for k in range(5)])
    values = json.loads((tmp_path / "transforms.json").read_text())
    assert [frame["file_path"] for frame in values["frames"]] == [f"rgb/{k}.jpg" for k in range(5)]
    assert (values["w"], values["h"]) == (640, 480)
    in_base = np.array([[1.2, 0.0, 0.0], [1.5, 0.3, 0.0], [1.1, -0.2, 0.1], [2.0, 0.1, 0.4]])
    ours = camera_from(camera)
    in_camera = (in_base - camera.base_from_camera[:3, 3]) @ camera.base_from_camera[:3, :3]
    ideal = in_camera @ camera.intrinsics.T
    expected = np.asarray(raw_from_ideal(ours, ideal[:, :2] / ideal[:, 2:]))
    for pose, frame in zip(where, values["frames"], strict=True):
        world = in_base @ pose[:3, :3].T + pose[:3, 3]
        np.testing.assert_allclose(nerfstudio_pixels(values, frame, world), expected, atol=1e-3)


def test_the_world_has_z_up_and_stays_so(tmp_path):
    write_transforms(tmp_path / "transforms.json", WITHOUT, poses(2), ["a.png", "b.png"])
    values = json.loads((tmp_path / "transforms.json").read_text())
    assert values["orientation_override"] == "none"
    for frame in values["frames"]:
        matrix = np.array(frame["transform_matrix"])
        assert matrix[2, 3] == pytest.approx(0.54)
        assert matrix[2, 1] > 0.9 and -matrix[2, 2] < 0  # the camera's y points up, its line of sight down


@pytest.mark.parametrize(
    "model, coefficients, why",
    [
        ("omnidirectional", (1.2, 0.1, 0.0, 0.0, 0.0), "no omnidirectional lens"),
        ("rational_polynomial", (*BROWN, 0.05, 0.1, 0.0, 0.2), "no k4, k6"),
        ("plumb_bob", (*BROWN, *(0.0,) * 4, 0.01, 0.0, 0.0, 0.02), "no s1, s4"),
        ("rational_polynomial", (*BROWN, *(0.0,) * 8, 0.01, 0.0), "no tau_x"),
    ],
)
def test_a_lens_that_nerfstudio_has_no_model_of_is_refused(tmp_path, model, coefficients, why):
    with pytest.raises(ValueError, match=rf"transforms\.json: nerfstudio.*{why}.*undistort"):
        write_transforms(tmp_path / "transforms.json", with_lens(model, coefficients), poses(1), ["a.png"])
    assert not (tmp_path / "transforms.json").exists()
    write_transforms(tmp_path / "transforms.json", WITHOUT, poses(1), ["a.png"])


@pytest.mark.parametrize("count, images", [(2, ["a.png"]), (0, [])])
def test_each_pose_has_an_image(tmp_path, count, images):
    with pytest.raises(ValueError, match=f"{len(images)} images for {count} poses"):
        write_transforms(tmp_path / "transforms.json", WITHOUT, poses(count), images)
