"""ROS: the YAML and INI of camera_calibration, CameraInfo as text, RTAB-Map's YAML."""

import numpy as np
import pytest
import yaml

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.calibration.camera_info import calibration_from_camera_info

K = [[500, 0, 319.5], [0, 510, 239.5], [0, 0, 1]]
D = (-0.3, 0.1, 0.001, -0.002, 0.0)
YAML = """image_width: 640
image_height: 480
camera_name: front
camera_matrix:
  rows: 3
  cols: 3
  data: [500, 0, 319.5,
         0, 510, 239.5,
         0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.3, 0.1, 0.001, -2e-3, 0]}
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [450, 0, 318, 0, 0, 460, 238, 0, 0, 0, 1, 0]
"""
INI = """# oST version 5.0 parameters

[image]

width
640

height
480

[front]

camera matrix
500.0 0.0 319.5
0.0 510.0 239.5
0.0 0.0 1.0

distortion
-0.3 0.1 0.001 -0.002 0.0

rectification
1 0 0
0 1 0
0 0 1

projection
450 0 318 0
0 460 238 0
0 0 1 0
"""
ECHO_1 = """header:
  seq: 7
  stamp: {secs: 1, nsecs: 2}
  frame_id: "camera"
height: 480
width: 640
distortion_model: "plumb_bob"
D: [-0.3, 0.1, 0.001, -0.002, 0.0]
K: [500.0, 0.0, 319.5, 0.0, 510.0, 239.5, 0.0, 0.0, 1.0]
R: [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
P: [450.0, 0.0, 318.0, 0.0, 0.0, 460.0, 238.0, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
binning_y: 0
roi:
  x_offset: 0
  y_offset: 0
  height: 0
  width: 0
  do_rectify: False
---
"""
ZERO = """height: 0
width: 0
distortion_model: ''
D: []
K: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
R: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
P: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
binning_x: 0
---
"""


def listed(name, values):
    return f"{name}:\n" + "".join(f"- {value}\n" for value in values)


ECHO_2 = (
    "header:\n  stamp:\n    sec: 1\n    nanosec: 2\n  frame_id: camera\nheight: 480\nwidth: 640\n"
    "distortion_model: plumb_bob\n"
    + listed("d", D)
    + listed("k", np.ravel(K))
    + listed("r", np.eye(3).ravel())
    + listed("p", [450, 0, 318, 0, 0, 460, 238, 0, 0, 0, 1, 0])
    + "binning_x: 1\nbinning_y: 1\nroi:\n  x_offset: 0\n  y_offset: 0\n  height: 480\n  width: 640\n"
    "  do_rectify: false\n---\n"
)
FORMS = {
    "yaml": YAML,
    "yaml of Windows": YAML.replace("\n", "\r\n"),
    "yaml with a mark": "\ufeff" + YAML,
    "yaml with quoted numbers": YAML.replace("640", '"640"').replace("319.5", "'319.5'"),
    "yaml with floats for sizes": YAML.replace("640", "640.0").replace("480", "4.8e2"),
    "yaml with rows": YAML.replace(
        "\n  rows: 3\n  cols: 3\n  data: [500, 0, 319.5,\n         0, 510, 239.5,\n         0, 0, 1]",
        " [[500, 0, 319.5], [0, 510, 239.5], [0, 0, 1]]",
    ),
    "yaml with comments": "# mine\n" + YAML.replace("\n", "   # said\n"),
    "yaml in capitals": YAML.replace("plumb_bob", "PLUMB_BOB"),
    "yaml without the lens's name": YAML.replace("distortion_model: plumb_bob\n", ""),
    "yaml in another order": yaml.safe_dump(yaml.safe_load(YAML)),
    "ini": INI,
    "ini of Windows": INI.replace("\n", "\r\n"),
    "ini in capitals, without blank lines": INI.upper().replace("\n\n", "\n"),
    "ROS 1": ECHO_1,
    "ROS 1 after zeros": "---\n" + ZERO + ZERO + ECHO_1 + ZERO,
    "ROS 1 after a cut message": "WARNING: no messages\n  and: [1, 2\n---\n" + ECHO_1,
    "ROS 1 in UTF-16": ECHO_1.encode("utf-16"),
    "ROS 2": ECHO_2,
    "ROS 2 twice": ECHO_2 + ECHO_2.replace("500", "400"),
}


@pytest.mark.parametrize("name", FORMS)
def test_raw_image_by_k_and_d(read, name):
    found = read(FORMS[name])
    np.testing.assert_array_equal(found.intrinsics, K)
    assert (found.width, found.height) == (640, 480)
    assert (found.distortion_model, found.distortion) == ("plumb_bob", D)
    assert found.notes == ()


@pytest.mark.parametrize(
    "model, count, expected",
    [
        ("rational_polynomial", 8, "rational_polynomial"),
        ("rational_polynomial", 14, "rational_polynomial"),
        ("rational_polynomial", 5, "plumb_bob"),
        ("plumb_bob", 8, "rational_polynomial"),
        ("plumb_bob", 4, "plumb_bob"),
        ("equidistant", 4, "equidistant"),
        ("fisheye", 4, "equidistant"),
    ],
)
def test_lenses(read, model, count, expected):
    values = tuple(0.01 * (index + 1) for index in range(count))
    text = YAML.replace("cols: 5, data: [-0.3, 0.1, 0.001, -2e-3, 0]", f"cols: {count}, data: {list(values)}")
    found = read(text.replace("plumb_bob", model))
    assert (found.distortion_model, found.distortion) == (expected, values)


def test_equidistant_with_a_zero_too_many(read):
    found = read(YAML.replace("plumb_bob", "equidistant").replace("-2e-3, 0]", "-2e-3, 0.]"))
    assert (found.distortion_model, len(found.distortion)) == ("equidistant", 4)


def test_no_distortion_is_a_pinhole(read):
    text = YAML.replace("[-0.3, 0.1, 0.001, -2e-3, 0]", "[0, 0, 0, 0, 0]")
    found = read(text)
    assert (found.distortion_model, found.distortion, found.notes) == ("pinhole", (), ())
    np.testing.assert_array_equal(found.intrinsics, K)
    assert "as ROS does" in read(text.replace("plumb_bob", "equidistant")).notes[0]


def test_empty_d(read):
    found = read(ECHO_1.replace("[-0.3, 0.1, 0.001, -0.002, 0.0]", "[]"))
    assert (found.distortion_model, found.distortion) == ("pinhole", ())


def test_binning_and_region(read):
    text = ECHO_1.replace("binning_x: 0", "binning_x: 2").replace("binning_y: 0", "binning_y: 2")
    found = read(text)
    half = Calibration("", "", 640, 480, np.array(K, float)).scaled(320, 240)
    np.testing.assert_allclose(found.intrinsics, half.intrinsics, rtol=1e-14)
    assert (found.width, found.height) == (320, 240)
    assert "binning 2 x 2 of the full 640 x 480 px are applied: 320 x 240 px" in found.notes[0]
    cut = read(text.replace("x_offset: 0", "x_offset: 20").replace("y_offset: 0", "y_offset: 40")
               .replace("height: 0", "height: 400").replace("width: 0", "width: 600"))  # fmt: skip
    np.testing.assert_allclose(cut.intrinsics - half.intrinsics, [[0, 0, -10], [0, 0, -20], [0, 0, 0]], atol=1e-12)
    assert (cut.width, cut.height) == (300, 200)


def test_only_p(read):
    text = ECHO_1.replace("K: [500.0, 0.0, 319.5, 0.0, 510.0, 239.5, 0.0, 0.0, 1.0]", "K: [0, 0, 0, 0, 0, 0, 0, 0, 0]")
    found = read(text.replace("[-0.3, 0.1, 0.001, -0.002, 0.0]", "[]"))
    np.testing.assert_array_equal(found.intrinsics, [[450, 0, 318], [0, 460, 238], [0, 0, 1]])
    assert "K is zero; P is used" in found.notes[0]


def test_message_as_a_mapping(tmp_path):
    fields = {"width": 640, "height": 480, "distortion_model": "plumb_bob", "d": list(D), "k": np.ravel(K).tolist()}
    found = calibration_from_camera_info(tmp_path / "a.bag", fields, "a topic")
    np.testing.assert_array_equal(found.intrinsics, K)
    assert found.kind == "a topic"


@pytest.mark.parametrize(
    "before, after, words",
    [
        ("image_width: 640\n", "", "no image size; add 'image_width', in pixels"),
        ("image_width: 640\nimage_height: 480\n", "", "no image size; add 'image_width' and 'image_height'"),
        ("camera_matrix:", "matrix:", "no key 'camera_matrix'"),
        ("distortion_coefficients:", "coefficients:", "no key 'distortion_coefficients'"),
        ("500, 0, 319.5", "-500, 0, 319.5", "'camera_matrix'.*focal lengths|'K' has the focal lengths -500.*not pos"),
        ("500, 0, 319.5", ".nan, 0, 319.5", r"'camera_matrix\.data' is nan, not a finite number"),
        ("500, 0, 319.5", "oops, 0, 319.5", r"'camera_matrix\.data' is 'oops', not a number"),
        ("500, 0, 319.5", "500, 319.5", "has 8 numbers, not 3 x 3"),
        ("500, 0, 319.5", "500, 0, 700", r"the principal point \(700, 239.5\) is outside the image of 640 x 480"),
        ("500, 0, 319.5", "1.2, 0, 319.5", "in pixels, not in millimetres"),
        ("0, 0, 1]\ndist", "0, 1, 1]\ndist", "no camera matrix; its rows must be"),
        ("cols: 5, data", "cols: 6, data", "has 5 numbers, not 1 x 6"),
        ("cols: 5, data: [-0.3,", "cols: 6, data: [1, 2,", "6 coefficients of a plumb_bob lens, which has 4 or 5"),
        ("plumb_bob", "thin_prism", "lenses of the kind 'thin_prism' are not read"),
        ("450, 0, 318, 0, ", "450, 0, 318, ", "has 11 numbers, not 3 x 4"),
        ("image_width: 640", "image_width: 640.5", "'image_width' is 640.5, not a whole number"),
        ("image_width: 640", "image_width: true", "'image_width' is True, not a number"),
        ("image_height: 480", "image_height: 480\nimage_width: 1280", "line 3: the key 'image_width' is there twice"),
    ],
)
def test_faults_of_the_yaml(read, before, after, words):
    assert before in YAML
    with pytest.raises(ValueError, match=rf"camera\.calibration.*({words})"):
        read(YAML.replace(before, after))


@pytest.mark.parametrize(
    "text, words",
    [
        (ZERO + ZERO, "all 2 messages are zero: the camera was not calibrated"),
        (ECHO_1.replace("width: 640\n", ""), "no key 'width'"),
        (ECHO_1.replace("x_offset: 0", "x_offset: 600").replace("width: 0", "width: 100"), "'roi' is outside"),
        (ECHO_1.replace("binning_x: 0", "binning_x: -2"), "'binning_x' is -2, not a finite positive"),
        (ECHO_1.replace("500.0, 0.0,", "500.0,"), "'K' has 8 numbers, not 9"),
        (INI.replace("width\n640\n", ""), "no key 'width'"),
        (INI.replace("distortion\n-0.3 0.1 0.001 -0.002 0.0\n", ""), "no key 'distortion'"),
        (INI.replace("0.0 510.0 239.5\n", "0.0 510.0\n"), "'camera matrix' has 8 numbers, not 9"),
        (INI.replace("319.5", "3l9.5"), "'camera matrix' is '3l9.5', not a number"),
        (INI + INI, "'width' is there twice; give a file of one camera"),
    ],
)
def test_faults_of_the_others(read, text, words):
    with pytest.raises(ValueError, match=rf"camera\.calibration: {words}"):
        read(text)


def test_a_file_of_one_camera_has_no_names(read):
    with pytest.raises(ValueError, match=r"of one camera; do not name a camera \('cam1'\)"):
        read(YAML, camera="cam1")


RTABMAP = "%YAML:1.0\n---\n" + YAML
STRAIGHT = RTABMAP.replace("[-0.3, 0.1, 0.001, -2e-3, 0]", "[0., 0., 0., 0., 0.]")
MOUNT = """local_transform:
   rows: 3
   cols: 4
   data: [ 0., 0., 1., 0.2, -1., 0., 0., 0., 0., -1., 0., 0.5 ]
"""


def test_rtabmap_prefers_p_of_rectified_images(read):
    found = read(STRAIGHT)
    np.testing.assert_array_equal(found.intrinsics, [[450, 0, 318], [0, 460, 238], [0, 0, 1]])
    assert found.distortion_model == "pinhole"
    assert "camera_matrix differs from projection_matrix; projection_matrix is used" in found.notes[0]
    assert found.base_from_camera is None


def test_rtabmap_with_a_lens_is_of_raw_images(read):
    found = read(RTABMAP)
    np.testing.assert_array_equal(found.intrinsics, K)
    assert (found.distortion_model, found.distortion) == ("plumb_bob", D)
    assert "those out of RTAB-Map's database are rectified already" in found.notes[0]


def test_rtabmap_mount(read):
    found = read(STRAIGHT + MOUNT)
    np.testing.assert_array_equal(found.base_from_camera @ [0, 0, 2, 1], [2.2, 0, 0.5, 1])
    unknown = read(STRAIGHT + MOUNT.replace("0.2", "0.").replace("0.5", "0."))
    assert unknown.base_from_camera is None
    assert "at the base's origin" in unknown.notes[1]
    with pytest.raises(ValueError, match="'local_transform' is not a rigid transform"):
        read(STRAIGHT + MOUNT.replace("1., 0.2", "2., 0.2"))
