import json

import numpy as np
import pytest

K = [[400, 0, 320], [0, 410, 240], [0, 0, 1]]
D = (-0.1, 0.02, 0.001, -0.002, 0.3)
STREAM = {"width": 640, "height": 480, "fx": 400, "fy": 410, "ppx": 320, "ppy": 240, "coeffs": [0.0] * 5}


@pytest.mark.parametrize(
    "model, coefficients, expected, distortion",
    [
        ("distortion.inverse_brown_conrady", [0] * 5, "pinhole", ()),
        ("Inverse Brown Conrady", [0] * 5, "pinhole", ()),
        ("RS2_DISTORTION_NONE", [0] * 5, "pinhole", ()),
        ("distortion.modified_brown_conrady", [0] * 5, "pinhole", ()),
        ("distortion.brown_conrady", D, "plumb_bob", D),
        ("Brown Conrady", D, "plumb_bob", D),
        (4, D, "plumb_bob", D),
        ("kannala_brandt4", [*D[:4], 0.0], "equidistant", D[:4]),
    ],
)
def test_realsense(read, model, coefficients, expected, distortion):
    found = read(json.dumps(STREAM | {"model": model, "coeffs": list(coefficients)}))
    np.testing.assert_array_equal(found.intrinsics, K)
    assert (found.distortion_model, found.distortion, found.notes) == (expected, tuple(distortion), ())


def test_inverse_brown_conrady_with_coefficients_is_noted(read):
    found = read(json.dumps(STREAM | {"model": "distortion.inverse_brown_conrady", "coeffs": list(D)}))
    assert (found.distortion_model, found.distortion) == ("plumb_bob", D)
    assert "taken as plumb_bob, which can be wrong by pixels at the corners" in found.notes[0]


def test_streams_of_realsense(read):
    stream = STREAM | {"model": "none"}
    text = json.dumps({"device": {"depth": stream | {"fx": 300}, "color": stream}, "more": [stream]})
    assert read(text).intrinsics[0, 0] == 400
    assert "device/color is used; the file also has device/depth, more/0" in read(text).notes[0]
    assert read(text, camera="depth").intrinsics[0, 0] == 300
    with pytest.raises(ValueError, match="no cameras named 'infrared'; give one of device/depth, device/color"):
        read(text, camera="infrared")


@pytest.mark.parametrize(
    "change, words",
    [
        ({"model": "distortion.ftheta", "coeffs": [0.1] * 5}, "lenses of the kind 'ftheta' are not read"),
        ({"model": "distortion.modified_brown_conrady", "coeffs": [0.1] * 5}, "'modified_brown_conrady' are not read"),
        ({"model": "none", "coeffs": [0.1] * 5}, "a lens 'none' with coefficients that are not zero"),
        ({"model": "none", "fx": float("nan")}, "'fx' is nan, not a finite"),
        ({}, "no key 'model'"),
    ],
)
def test_faults_of_realsense(read, change, words):
    with pytest.raises(ValueError, match=rf"camera\.calibration: .*{words}"):
        read(json.dumps(STREAM | change))
