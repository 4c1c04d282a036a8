import json

import numpy as np
import pytest

K = [[400, 0, 320], [0, 410, 240], [0, 0, 1]]
D = (-0.1, 0.02, 0.001, -0.002, 0.3)
GYROFLOW = {
    "name": "a camera", "camera_model": "HERO", "calib_dimension": {"w": 640, "h": 480}, "use_opencv_fisheye": True,
    "input_horizontal_stretch": 1.0, "fisheye_params": {"camera_matrix": K, "distortion_coeffs": list(D[:4])},
}  # fmt: skip


def test_gyroflow(read):
    found = read(json.dumps(GYROFLOW))
    np.testing.assert_array_equal(found.intrinsics, K)
    assert (found.width, found.height) == (640, 480)
    assert (found.distortion_model, found.distortion, found.notes) == ("equidistant", D[:4], ())
    assert read(json.dumps(GYROFLOW | {"distortion_model": "opencv_standard"})).distortion_model == "plumb_bob"


@pytest.mark.parametrize(
    "change, words",
    [
        ({"distortion_model": "poly5"}, "lenses of the kind 'poly5' are not read"),
        ({"digital_lens": "gopro_superview"}, "digital_lens 'gopro_superview' is not read"),
        ({"input_horizontal_stretch": 1.33}, "the profile is of a stretched image"),
        ({"fisheye_params": {"camera_matrix": []}}, "'fisheye_params.camera_matrix' has 0 numbers, not 9"),
        ({"fisheye_params": {"camera_matrix": K}}, "no key 'fisheye_params.distortion_coeffs'"),
        ({"calib_dimension": {"w": 640}}, "no key 'calib_dimension.h'"),
    ],
)
def test_faults_of_gyroflow(read, change, words):
    with pytest.raises(ValueError, match=rf"camera\.calibration: {words}"):
        read(json.dumps(GYROFLOW | change))
