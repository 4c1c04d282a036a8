"""Seeds: a file of every kind of calibration that `read_calibration` knows, as its program writes it."""

import json

import cv2
import numpy as np

from .mutate import Input
from .seed_texts import CAMERA, MOUNT, K, text

D = [-0.1, 0.02, 0.001, -0.002, 0.0]
ROWS = [K[:3], K[3:6], K[6:]]
P = [400.0, 0.0, 320.0, 0.0, 0.0, 410.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]
EYE = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
ROS = f"""image_width: 640
image_height: 480
camera_name: front
camera_matrix:
  rows: 3
  cols: 3
  data: {K}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: {D}}}
rectification_matrix: {{rows: 3, cols: 3, data: {EYE}}}
projection_matrix: {{rows: 3, cols: 4, data: {P}}}
"""
ECHO = f"""header:
  seq: 7
  stamp: {{secs: 1, nsecs: 2}}
  frame_id: "camera"
height: 480
width: 640
distortion_model: "plumb_bob"
D: {D}
K: {K}
R: {EYE}
P: {P}
binning_x: 2
binning_y: 2
roi: {{x_offset: 8, y_offset: 8, height: 400, width: 600, do_rectify: False}}
---
"""
INI = """# oST version 5.0 parameters

[image]

width
640

height
480

[front]

camera matrix
400.0 0.0 320.0
0.0 410.0 240.0
0.0 0.0 1.0

distortion
-0.1 0.02 0.001 -0.002 0.0

rectification
1 0 0
0 1 0
0 0 1

projection
400 0 320 0
0 410 240 0
0 0 1 0
"""
KALIBR = f"""cam0:
  T_cam_imu: {np.eye(4).tolist()}
  camera_model: pinhole
  distortion_coeffs: {D[:4]}
  distortion_model: radtan
  intrinsics: [400, 410, 320, 240]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
cam1:
  camera_model: omni
  distortion_coeffs: {D[:4]}
  distortion_model: radtan
  intrinsics: [1.5, 800.0, 810.0, 320.0, 240.0]
  resolution: [640, 480]
"""
EUROC = f"""%YAML:1.0
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: {np.eye(4).ravel().tolist()}
resolution: [640, 480]
camera_model: pinhole
intrinsics: [400, 410, 320, 240] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: {D[:4]}
"""
KIMERA = (
    EUROC.replace("pinhole", "omni").replace("radial-tangential", "omni").replace("[400, 410, 320, 240]", "[]")
    .replace(str(D[:4]), "[300, 0, -1e-3, 0, 0]")
    + "omni_affine: [0.0, 0.0, 1.01]\nomni_distortion_center: [321.5, 238.5]\n"
)  # fmt: skip
ORBSLAM = """%YAML:1.0
Camera.type: "PinHole"
Camera.fx: 400
Camera.fy: 410.0
Camera.cx: 320.0
Camera.cy: 240.0
Camera.k1: -0.1
Camera.k2: 0.02
Camera.p1: 1e-3
Camera.p2: -0.002
Camera.width: 640
Camera.height: 480
Camera.fps: 30.0
DepthMapFactor: 5000.0
LEFT.width: 640
LEFT.height: 480
LEFT.K: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [300, 0, 310, 0, 300, 250, 0, 0, 1]
LEFT.D: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [-0.2, 0.07, 0, 0, 0]
"""
CAMODOCAL = """%YAML:1.0
---
model_type: MEI
camera_name: camera
image_width: 640
image_height: 480
mirror_parameters:
   xi: 1.5
distortion_parameters:
   k1: -0.1
   k2: 0.02
   p1: 0.001
   p2: -0.002
projection_parameters:
   gamma1: 400
   gamma2: 410
   u0: 320
   v0: 240
"""
COLMAP = """# Camera list
1 OPENCV 640 480 400 410 320.5 240.5 -0.1 0.02 0.001 -0.002
2 SIMPLE_RADIAL 640 480 400 320.5 240.5 -0.1
"""


def _opencv(ending: str) -> bytes:
    file = cv2.FileStorage(f"x.{ending}", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for key, value in (("camera_matrix", ROWS), ("distortion_coefficients", [D])):
        file.write(key, np.array(value, float))
    for key, size in (("image_width", 640), ("image_height", 480)):
        file.write(key, size)
    return file.releaseAndGetString().encode()


def calibrations() -> list[Input]:
    """One of every kind, more where a kind has several forms."""
    stream = {"width": 640, "height": 480, "fx": 400, "fy": 410, "ppx": 320, "ppy": 240, "model": "none"}
    realsense = {"device": {"color": stream | {"coeffs": [0.0] * 5}, "depth": stream | {"coeffs": [0.0] * 5}}}
    gyroflow = {"calib_dimension": {"w": 640, "h": 480}, "input_horizontal_stretch": 1.0}
    gyroflow["fisheye_params"] = {"camera_matrix": ROWS, "distortion_coeffs": D[:4]}
    rtabmap = "%YAML:1.0\n---\n" + ROS + f"local_transform: {{rows: 3, cols: 4, data: {sum(MOUNT[:3], [])}}}\n"  # noqa: RUF017
    duckietown = "homography: [0.0, 0.001, -0.2, 0.001, 0.0, -0.3, 0.0, -0.008, 1.0]\n"
    texts = {
        "camera.json": json.dumps(CAMERA | {"distortion_model": "plumb_bob", "D": D}), "ros.yaml": ROS,
        "echo.yaml": ECHO, "videre.ini": INI, "kalibr.yaml": KALIBR, "euroc.yaml": EUROC, "kimera.yaml": KIMERA,
        "orbslam.yaml": ORBSLAM, "camodocal.yaml": CAMODOCAL, "colmap.txt": COLMAP,
        "gyroflow.json": json.dumps(gyroflow), "realsense.json": json.dumps(realsense), "rtabmap.yaml": rtabmap,
        "duckietown.yaml": duckietown,
        "json_of_rows.json": json.dumps({"mtx": ROWS, "dist": [D], "image_size": [640, 480]}),
    }  # fmt: skip
    return [text(name, content) for name, content in texts.items()] + [
        text(f"opencv.{ending}", _opencv(ending)) for ending in ("yaml", "xml", "json")
    ]
