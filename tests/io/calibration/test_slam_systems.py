"""Kalibr, EuRoC and Kimera, ORB-SLAM, VINS."""

import numpy as np
import pytest

K = [[400, 0, 320], [0, 410, 240], [0, 0, 1]]
D = (-0.1, 0.02, 0.001, -0.002)
KALIBR = """cam0:
  T_cam_imu:
  - [1.0, 0.0, 0.0, 0.1]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.1, 0.02, 1e-3, -0.002]
  distortion_model: radtan
  intrinsics: [400, 410, 320, 240]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, 0.1]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: omni
  distortion_coeffs: [-0.1, 0.02, 0.001, -0.002]
  distortion_model: radtan
  intrinsics: [1.5, 800.0, 810.0, 320.0, 240.0]
  resolution: [640, 480]
"""
EUROC = """%YAML:1.0
# General sensor definitions.
sensor_type: camera
comment: VI-Sensor cam0
T_BS:
  cols: 4
  rows: 4
  data: [1.0, 0.0, 0.0, 0.1,
         0.0, 1.0, 0.0, 0.0,
         0.0, 0.0, 1.0, 0.0,
         0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [640, 480]
camera_model: pinhole
intrinsics: [400, 410, 320, 240] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.1, 0.02, 0.001, -0.002]
"""
ORB = """%YAML:1.0

#---------------
# Camera Parameters. Adjust them!
#---------------
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
Viewer.PointSize: 2
"""
VINS = """%YAML:1.0
---
model_type: PINHOLE
camera_name: camera
image_width: 640
image_height: 480
distortion_parameters:
   k1: -0.1
   k2: 0.02
   p1: 0.001
   p2: -0.002
projection_parameters:
   fx: 400
   fy: 410
   cx: 320
   cy: 240
"""
FISHEYE = VINS.replace("PINHOLE", "KANNALA_BRANDT").split("distortion_parameters")[0] + (
    "projection_parameters:\n  k2: -0.1\n  k3: 0.02\n  k4: 0.001\n  k5: -0.002\n"
    "  mu: 400\n  mv: 410\n  u0: 320\n  v0: 240\n"
)
MEI = (
    VINS.replace("PINHOLE", "MEI")
    .replace("distortion_par", "mirror_parameters:\n  xi: 1.5\ndistortion_par")
    .replace("fx: 400\n   fy: 410\n   cx: 320\n   cy: 240", "gamma1: 400\n   gamma2: 410\n   u0: 320\n   v0: 240")
)
FORMS = {
    "Kalibr": (KALIBR, "plumb_bob", D),
    "Kalibr of Windows": (KALIBR.replace("\n", "\r\n"), "plumb_bob", D),
    "Kalibr in capitals": (KALIBR.replace("radtan", "RadTan").replace("pinhole", "Pinhole"), "plumb_bob", D),
    "Kalibr equidistant": (KALIBR.replace("radtan", "equidistant"), "equidistant", D),
    "Kalibr none": (KALIBR.replace("radtan", "none").replace("[-0.1, 0.02, 1e-3, -0.002]", "[]"), "pinhole", ()),
    "OpenVINS": ("%YAML:1.0 # a word\n\n" + KALIBR.replace("T_cam_imu", "T_imu_cam"), "plumb_bob", D),
    "one camera of Kalibr": (
        KALIBR.split("cam1:")[0].replace("cam0:\n", "").replace("\n  ", "\n").removeprefix("  "), "plumb_bob", D,
    ),
    "EuRoC": (EUROC, "plumb_bob", D),
    "EuRoC with tabs": (EUROC.replace(": ", ":\t"), "plumb_bob", D),
    "EuRoC equidistant": (EUROC.replace("radial-tangential", "equidistant"), "equidistant", D),
    "EuRoC none": (EUROC.replace("radial-tangential", "none").replace("[-0.1, 0.02, 0.001, -0.002]", "[0, 0, 0, 0]"),
                   "pinhole", ()),
    "ORB-SLAM3": (ORB, "plumb_bob", (*D, 0.0)),
    "ORB-SLAM2": (ORB.replace('Camera.type: "PinHole"\n', ""), "plumb_bob", (*D, 0.0)),
    "ORB-SLAM3, new names": (
        ORB.replace("Camera.", "Camera1.").replace("Camera1.width", "Camera.width")
        .replace("Camera1.height", "Camera.height").replace("Camera1.type", "Camera.type"), "plumb_bob", (*D, 0.0),
    ),
    "ORB-SLAM3 with a slip that only OpenCV reads": (ORB.replace("PointSize: ", "PointSize:"), "plumb_bob", (*D, 0.0)),
    "ORB-SLAM3 fisheye": (
        ORB.replace("PinHole", "KannalaBrandt8").replace("p1", "k3").replace("p2", "k4"), "equidistant", D,
    ),
    "ORB-SLAM3 rectified": (
        "".join(line for line in ORB.splitlines(True) if line[7:9] not in ("k1", "k2", "p1", "p2"))
        .replace("PinHole", "Rectified"), "pinhole", (),
    ),
    "VINS": (VINS, "plumb_bob", D),
    "VINS fisheye": (FISHEYE, "equidistant", D),
    "VINS omnidirectional": (MEI, "omnidirectional", (1.5, *D)),
    "VINS rational": (
        VINS.replace("PINHOLE", "PINHOLE_FULL").replace("   p1", "   k3: 1\n   k4: 2\n   k5: 3\n   k6: 4\n   p1"),
        "rational_polynomial", (*D, 1.0, 2.0, 3.0, 4.0),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FORMS)
def test_values(read, name):
    text, model, distortion = FORMS[name]
    found = read(text)
    np.testing.assert_array_equal(found.intrinsics, K)
    assert (found.width, found.height, found.distortion_model) == (640, 480, model)
    assert found.distortion == distortion
    assert found.base_from_camera is None, "these files place the camera on an IMU, not on the base"


def test_notes(read):
    chosen, transform = read(KALIBR).notes
    assert "camera cam0 is used; the file also has cam1" in chosen
    assert "T_cam_imu not used: not the camera's place on the robot's base" in transform
    assert "T_BS not used" in read(EUROC).notes[0]
    assert read(ORB).notes == ()


@pytest.mark.parametrize("name", ["cam1", "CAM1", "1"])
def test_second_camera_of_kalibr(read, name):
    found = read(KALIBR, camera=name)
    np.testing.assert_array_equal(found.intrinsics, [[800, 0, 320], [0, 810, 240], [0, 0, 1]])
    assert (found.distortion_model, found.distortion) == ("omnidirectional", (1.5, *D))
    assert len(found.notes) == 1


def test_depth_scale_of_orbslam(read):
    assert read(ORB).depth_scale == 5000.0
    assert read(ORB.replace("DepthMapFactor", "RGBD.DepthMapFactor")).depth_scale == 5000.0
    assert read(ORB.replace("DepthMapFactor", "Other")).depth_scale is None


def test_stereo_of_orbslam2(read):
    text = ORB + (
        "LEFT.width: 640\nLEFT.height: 480\n"
        "LEFT.K: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [300, 0, 310, 0, 300, 250, 0, 0, 1]\n"
        "LEFT.D: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [-0.2, 0.07, 0, 0, 0]\n"
    )
    found = read(text)
    assert found.intrinsics[0, 0] == 400
    assert "for raw images choose LEFT" in found.notes[1]
    left = read(text, camera="left")
    assert (left.intrinsics[0, 0], left.distortion[:2]) == (300, (-0.2, 0.07))


@pytest.mark.parametrize(
    "text, words",
    [
        (KALIBR.replace("radtan", "fov", 1), "lenses of the kind 'fov' are not read"),
        (KALIBR.replace("camera_model: pinhole", "camera_model: ds"), "cam0.camera_model 'ds' is not read"),
        (KALIBR.replace("camera_model: pinhole", "camera_model: eucm"), "cam0.camera_model 'eucm' is not read"),
        (KALIBR.replace("320, 240]", "320]"), "'cam0.intrinsics' has 3 numbers, not 4"),
        (KALIBR.replace("[400,", "[-400,"), r"'cam0.intrinsics\[0\]' is -400.0, not a finite positive number"),
        (KALIBR.replace("  resolution: [640, 480]\n", ""), "no image size; add 'cam0.resolution'"),
        (KALIBR.replace("  intrinsics: [400, 410, 320, 240]\n", ""), "no key 'cam0.intrinsics'"),
        (KALIBR.replace("[640, 480]", "[640]"), "'cam0.resolution' has 1 numbers, not 2"),
        (KALIBR.replace("1e-3, -0.002", "1e-3"), "3 coefficients of a plumb_bob lens, which has 4 or 5"),
        (EUROC.replace("sensor_type: camera", "sensor_type: imu"), "of a sensor 'imu'; give the sensor.yaml of a cam"),
        (EUROC.replace("intrinsics:", "intrinsic:"), "no key 'intrinsics'"),
        (ORB.replace("PinHole", "Fov"), "'Camera.type' 'Fov' is not read; PinHole, KannalaBrandt8 and Rectified are"),
        (ORB.replace("p1", "k4"), "'Camera.k4' is none of a PinHole camera"),
        (ORB.replace("Camera.fy: 410.0\n", ""), "no key 'Camera.fy'"),
        (ORB.replace("Camera.width: 640\n", ""), "no image size; add 'Camera.width', in pixels"),
        (ORB.replace("5000.0", "0"), "'DepthMapFactor' is 0, not a finite positive number"),
        (VINS.replace("PINHOLE", "SCARAMUZZA"), "model_type 'SCARAMUZZA' is not read; PINHOLE, "),
        (VINS.replace("   p2: -0.002\n", ""), "no key 'p2'"),
    ],
)
def test_faults(read, text, words):
    with pytest.raises(ValueError, match=rf"camera\.calibration: {words}"):
        read(text)


@pytest.mark.parametrize("name, words", [("cam2", "no cameras named 'cam2'"), ("m", "no cameras"), ("", "2 cameras")])
def test_names_that_are_not_there(read, name, words):
    with pytest.raises(ValueError, match=f"{words}.*; give one of cam0, cam1"):
        read(KALIBR, camera=name)


OMNI = EUROC.replace("pinhole", "omni").replace("radial-tangential", "omni").replace("[400, 410, 320, 240]", "[]")
OMNI = OMNI.replace("[-0.1, 0.02, 0.001, -0.002]", "[300, 0, -1e-3, 0, 0]") + (
    "omni_affine: [0.0, 0.0, 1.01]\nomni_distortion_center: [321.5, 238.5]\n"
)


def test_polynomial_of_kimera(read):
    found = read(OMNI)
    assert found.distortion_model == "equidistant"
    np.testing.assert_allclose(found.intrinsics[:2, 2], [321.5, 238.5])
    np.testing.assert_allclose(found.intrinsics[1, 1] / found.intrinsics[0, 0], 1.01)
    radius = 200.0
    angle = np.arctan2(radius, 300 - 1e-3 * radius**2)
    bent = angle + sum(k * angle**p for k, p in zip(found.distortion, (3, 5, 7, 9), strict=True))
    assert abs(found.intrinsics[0, 0] * bent - radius) < 0.1


@pytest.mark.parametrize(
    "before, after", [("[300, 0", "[-300, 0"), ("[0.0, 0.0, 1.01]", "[0.1, 0.0, 1.0]"), ("-1e-3", "1e-2")]
)
def test_polynomials_that_are_not_read(read, before, after):
    with pytest.raises(ValueError, match=r"polynomial.*calibrate again with Kalibr"):
        read(OMNI.replace(before, after))
