import json

import numpy as np
import pytest

K = [[400, 0, 320], [0, 410, 240], [0, 0, 1]]
D = (-0.1, 0.02, 0.001, -0.002, 0.3)
OWN = {
    "fx": 400, "fy": 410, "cx": 320, "cy": 240, "width": 640, "height": 480, "depth_scale": 1000,
    "T_base_camera": [[0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 0.5], [0, 0, 0, 1]],
}  # fmt: skip


def test_camera_json(read):
    found = read(json.dumps(OWN))
    np.testing.assert_array_equal(found.intrinsics, K)
    np.testing.assert_array_equal(found.base_from_camera, OWN["T_base_camera"])
    assert (found.width, found.height, found.depth_scale, found.kind) == (640, 480, 1000.0, "camera.json")
    assert (found.distortion_model, found.distortion, found.notes) == ("pinhole", (), ())


def test_camera_json_with_a_lens_and_without_depth(read):
    values = {key: value for key, value in OWN.items() if key != "depth_scale"}
    found = read(json.dumps(values | {"distortion_model": "plumb_bob", "D": D}))
    assert (found.distortion_model, found.distortion, found.depth_scale) == ("plumb_bob", D, None)


@pytest.mark.parametrize(
    "change, words",
    [
        ({"focal": 3}, "unknown key 'focal'"),
        ({"fx": None}, "'fx' is null, not a number"),
        ({"D": [1, 2]}, "'D' without 'distortion_model'"),
        ({"D": [1, 2], "distortion_model": "plumb_bob"}, "2 coefficients of a plumb_bob lens"),
    ],
)
def test_faults_of_camera_json(read, change, words):
    with pytest.raises(ValueError, match=rf"camera\.calibration.*{words}"):
        read(json.dumps(OWN | change))
    with pytest.raises(ValueError, match="no key 'T_base_camera'"):
        read(json.dumps({key: value for key, value in OWN.items() if key != "T_base_camera"}))
