import json

import cv2
import numpy as np
import pytest

from ebjax.geometry.mount_numbers import mount_of
from ebjax.io.logs.camera import camera_of
from ebjax.io.logs.mount_options import MountOptions
from ebjax.io.logs.open import open_log

K = [51.0, 0, 31.5, 0, 51.5, 23.5, 0, 0, 1]
OPENCV = f"""%YAML:1.0
---
camera_name: "front"
image_width: 64
image_height: 48
camera_matrix:
   rows: 3
   cols: 3
   data: {K}
distortion_model: plumb_bob
distortion_coefficients:
   rows: 1
   cols: 5
   data: [-0.28, 0.07, 0., 0., 0.]
"""
KALIBR = """cam0:
  camera_model: pinhole
  distortion_model: equidistant
  distortion_coeffs: [0.01, 0.002, 0.0, 0.0]
  intrinsics: [51.0, 51.5, 31.5, 23.5]
  resolution: [64, 48]
"""
INI = """# oST version 5.0 parameters
[image]
width
64
height
48
[front]
camera matrix
51.0 0 31.5
0 51.5 23.5
0 0 1
distortion
-0.28 0.07 0 0 0
rectification
1 0 0
0 1 0
0 0 1
projection
51.0 0 31.5 0
0 51.5 23.5 0
0 0 1 0
"""
FILES = {
    "cal.yaml": (OPENCV, "plumb_bob", (-0.28, 0.07, 0, 0, 0)),
    "camchain.yaml": (KALIBR, "equidistant", (0.01, 0.002, 0, 0)),
    "ost.txt": (INI, "plumb_bob", (-0.28, 0.07, 0, 0, 0)),
}
MOUNT = [[0.0, -0.6, 0.8, 0.2], [-1, 0, 0, 0], [0, -0.8, -0.6, 0.5], [0, 0, 0, 1]]


@pytest.fixture
def folder(tmp_path):
    """A run of three frames, whose camera.json has another K."""
    run = tmp_path / "run"
    run.mkdir()
    for k in range(3):
        cv2.imwrite(str(run / f"{k}.png"), np.full((48, 64, 3), 40 * k, np.uint8))
    (run / "rgb.txt").write_text("".join(f"{k}.5 {k}.png\n" for k in range(3)))
    camera = {"fx": 60, "fy": 60, "cx": 30, "cy": 20, "width": 64, "height": 48, "depth_scale": 5000}
    (run / "camera.json").write_text(json.dumps(camera | {"T_base_camera": MOUNT}))
    return run


@pytest.mark.parametrize("name", FILES)
def test_the_lens_comes_from_the_file_and_the_mount_and_depth_from_the_run(folder, tmp_path, name):
    text, model, distortion = FILES[name]
    (tmp_path / name).write_text(text)
    camera, _ = camera_of(open_log(folder), tmp_path / name)
    np.testing.assert_array_equal(camera.intrinsics.ravel(), K)
    assert (camera.distortion_model, camera.distortion) == (model, distortion)
    np.testing.assert_array_equal(camera.base_from_camera, MOUNT)
    assert camera.depth_scale == 5000


def test_the_mounts_own_file_and_numbers_come_before_it(folder, tmp_path):
    (tmp_path / "cal.yaml").write_text(OPENCV)
    other = json.loads((folder / "camera.json").read_text())
    other["T_base_camera"][2][3] = 0.9
    (tmp_path / "other.json").write_text(json.dumps(other))
    mount = MountOptions(file=tmp_path / "other.json", x_m=0.3)
    camera, _ = camera_of(open_log(folder), tmp_path / "cal.yaml", mount)
    np.testing.assert_allclose(mount_of(camera.base_from_camera)[3:], [0.9, 0.3, 0.0], atol=1e-12)
    np.testing.assert_allclose(mount_of(camera.base_from_camera)[0], np.arctan2(0.6, 0.8), atol=1e-12)
