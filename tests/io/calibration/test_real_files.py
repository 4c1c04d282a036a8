"""The values of real files, typed from them, and what was said about each."""

import numpy as np
import pytest

from ebjax.io.calibration.duckietown import read_duckietown, read_floor_homography
from ebjax.io.calibration.read import read_calibration

PLAIN = {
    "ros_plumb_bob_ost.yaml": (
        "ROS camera_info YAML", 1920, 1080, (1588.052924, 1586.031534, 964.986969, 538.015331),
        "plumb_bob", (-0.130096, 0.069268, -0.001506, -0.000456, 0.0),
    ),
    "ros_plumb_bob_ost_videre.ini": (
        "Videre INI", 1920, 1080, (1588.052924, 1586.031534, 964.986969, 538.015331),
        "plumb_bob", (-0.130096, 0.069268, -0.001506, -0.000456, 0.0),
    ),
    "ros_equidistant_jetbot.yaml": (
        "ROS camera_info YAML", 1280, 720, (653.57443, 653.59849, 605.49395, 380.09327),
        "equidistant", (0.000249, 0.276338, -0.460515, 0.277320),
    ),
    "rostopic_echo_camera_info.txt": (
        "CameraInfo printed by rostopic echo", 640, 480,
        (520.84106910681, 520.652683004955, 320.207922533597, 251.69140630101),
        "plumb_bob", (-0.344858300062205, 0.131731614744127, -0.00032220157418798, -0.000178643627395838, 0.0),
    ),
    "duckietown_ferrari_intrinsic.yaml": (
        "ROS camera_info YAML", 640, 480,
        (320.01662303646305, 322.50098821941157, 309.2304795708444, 211.72347209268685),
        "plumb_bob",
        (-0.27438022923425975, 0.05215872112103248, 0.0027000386512372036, -0.00018965250296526788, 0.0),
    ),
    "orbslam3_kannalabrandt8_tumvi.yaml": (
        "ORB-SLAM settings", 512, 512, (190.978477, 190.973307, 254.931706, 256.897442),
        "equidistant", (0.003482389402, 0.000715034845, -0.002053236141, 0.000202936736),
    ),
    "gyroflow_gopro_hero8_wide.json": (
        "Gyroflow lens profile", 2704, 1520,
        (1313.8460182961674, 1328.486856074191, 1357.8934849539112, 774.5112149777526),
        "equidistant", (0.03543465349437444, 0.11933179192552933, -0.1712502512670787, 0.09848134921081766),
    ),
}  # fmt: skip
NOTED = {
    "kalibr_radtan_rs_d455.yaml": (
        "Kalibr camchain", 848, 480, (416.85223429743274, 414.92069080087543, 421.02459311003213, 237.76180565241077),
        "plumb_bob", (-0.045761895748285604, 0.03423951132164367, -0.00040139057556727315, 0.000431371425853453),
        ["T_cam_imu not used"],
    ),
    "kalibr_equidistant_tum_vi.yaml": (
        "Kalibr camchain", 512, 512, (190.97847715128717, 190.9733070521226, 254.93170605935475, 256.8974428996504),
        "equidistant",
        (0.0034823894022493434, 0.0007150348452162257, -0.0020532361418706202, 0.00020293673591811182),
        ["cam0 is used; the file also has cam1", "T_cam_imu not used"],
    ),
    "kalibr_hilti_equidistant.yaml": (
        "Kalibr camchain", 720, 540, (351.31400364193297, 351.4911744656785, 367.8522793375995, 253.8402144980996),
        "equidistant",
        (-0.03696737352869157, -0.008917880497032812, 0.008912969593422046, -0.0037685977496087313),
        ["cam0 is used; the file also has cam1", "T_cam_imu not used"],
    ),
    "euroc_sensor.yaml": (
        "EuRoC or Kimera sensor YAML", 752, 480, (458.654, 457.296, 367.215, 248.375),
        "plumb_bob", (-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05), ["T_BS not used"],
    ),
    "realsense_intrinsics_typed.json": (
        "RealSense JSON", 640, 480, (607.558837890625, 607.0466918945312, 323.51959228515625, 248.81329345703125),
        "pinhole", (), ["231522072820/color is used; the file also has 231522072820/depth"],
    ),
    "rtabmap_export.yaml": (
        "RTAB-Map YAML", 640, 480, (554.38271282264407, 554.38271282264407, 320.5, 240.5),
        "pinhole", (), ["camera_matrix holds the first 9 numbers of projection_matrix; projection_matrix is used"],
    ),
}  # fmt: skip
UNSIZED = {
    "opencv_KD_cam.yml": (
        "image_width", (412.22319249328854, 412.58616533176189, 348.4791260983701, 258.5739006604201),
        (-0.40209438015234161, 0.20032473316516436, 0.0018339324304776402, 1.1636957793933773e-05,
         -0.056853048434465377),
    ),
    "orbslam2_tum1.yaml": (
        "Camera.width", (517.306408, 516.469215, 318.643040, 255.313989),
        (0.262383, -0.953104, -0.005358, 0.002628, 1.163314),
    ),
}  # fmt: skip


def matches(found, kind, width, height, intrinsics, model, distortion):
    fx, fy, cx, cy = intrinsics
    np.testing.assert_allclose(found.intrinsics, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], rtol=1e-12)
    assert (found.kind, found.width, found.height, found.distortion_model) == (kind, width, height, model)
    assert len(found.distortion) == len(distortion)
    np.testing.assert_allclose(found.distortion, distortion, rtol=1e-12)
    assert found.base_from_camera is None


@pytest.mark.parametrize("name", PLAIN)
def test_values_without_a_word(data, name):
    found = read_calibration(data("logs/calibrations") / name)
    matches(found, *PLAIN[name])
    assert found.notes == ()


@pytest.mark.parametrize("name", NOTED)
def test_values_and_notes(data, name):
    found = read_calibration(data("logs/calibrations") / name)
    *values, notes = NOTED[name]
    matches(found, *values)
    assert len(found.notes) == len(notes)
    for said, wanted in zip(found.notes, notes, strict=True):
        assert wanted in said and name in said


@pytest.mark.parametrize("name", UNSIZED)
def test_size_of_the_images_where_the_file_says_none(data, name):
    file = data("logs/calibrations") / name
    key, (fx, fy, cx, cy), distortion = UNSIZED[name]
    with pytest.raises(ValueError, match=f"{name}: no image size; add '{key}'"):
        read_calibration(file)
    found = read_calibration(file, size=(640, 480))
    np.testing.assert_allclose(found.intrinsics, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], rtol=1e-12)
    np.testing.assert_allclose(found.distortion, distortion, rtol=1e-12)
    assert (found.width, found.height, found.distortion_model) == (640, 480, "plumb_bob")
    assert "taken as that of the images, 640 x 480 px" in found.notes[0]


def test_second_camera_of_kalibr(data):
    found = read_calibration(data("logs/calibrations") / "kalibr_hilti_equidistant.yaml", camera="cam1")
    assert found.intrinsics[0, 0] == 352.6489794433894
    assert [note.partition(": ")[2][:20] for note in found.notes] == ["T_cam_imu and T_cn_c"]


def test_depth_stream_of_realsense(data):
    found = read_calibration(data("logs/calibrations") / "realsense_intrinsics_typed.json", camera="depth")
    assert found.intrinsics[0, 2] == 322.6656799316406


def test_kimera_polynomial(data):
    """Along the ray that Kimera gives a pixel, the equidistant lens must lead back to that pixel."""
    found = read_calibration(data("logs/calibrations") / "kimera_omni.yaml")
    assert (found.width, found.height, found.distortion_model) == (2000, 1500, "equidistant")
    assert "fits it to 0.053 px" in found.notes[0]
    pixel = np.random.default_rng(0).uniform([0, 0], [2000, 1500], (200, 2))
    centre = np.array([1005.817454205254, 743.034296906609])
    radius = np.linalg.norm(pixel - centre, axis=1)
    ahead = 875.074642516832 - 0.00030379174233022 * radius**2 - 4.81892212543229e-08 * radius**3
    angle = np.arctan2(radius, ahead + 1.71277628064668e-11 * radius**4)
    bent = angle + sum(k * angle**p for k, p in zip(found.distortion, (3, 5, 7, 9), strict=True))
    unit = (pixel - centre) / radius[:, None]
    again = unit * bent[:, None] @ found.intrinsics[:2, :2].T + found.intrinsics[:2, 2]
    np.testing.assert_allclose(again, pixel, atol=0.06)


def test_duckietown_extrinsics(data):
    folder = data("logs/calibrations")
    extrinsics = folder / "duckietown_ferrari_extrinsic.yaml"
    with pytest.raises(ValueError, match=r"extrinsic\.yaml: Duckietown's extrinsics.*give the intrinsics file"):
        read_calibration(extrinsics)
    homography = read_floor_homography(extrinsics)
    np.testing.assert_array_equal(homography[[0, 1, 2], [0, 0, 2]], [-0.0001040121, 0.001052662, 1])
    found = read_duckietown(folder / "duckietown_ferrari_intrinsic.yaml", extrinsics)
    right, up, _ = columns = np.linalg.inv(found.floor_from_image @ found.intrinsics).T
    lengths = np.linalg.norm([right, up], axis=1)
    assert abs(lengths[1] / lengths[0] - 1) < 0.02, "the floor's axes are equally long as the camera sees them"
    assert abs(right @ up) / lengths.prod() < 0.02, "and square"
    axes = np.column_stack([right, up, np.cross(right, up) / lengths[0]])
    camera = -np.linalg.inv(axes) @ columns[2]
    np.testing.assert_allclose(np.abs(camera), [0.063, 0.0, 0.115], atol=0.002)
