import json

import numpy as np
import pytest

from ebjax.io.camera_file import KEYS, read_camera, write_camera

CAMERA = {
    "fx": 600, "fy": 601.5, "cx": 320.0, "cy": 240.0, "width": 640, "height": 480, "depth_scale": 1000.0,
    "T_base_camera": [[0, 0, 1, 0.27], [-1, 0, 0, 0], [0, -1, 0, 0.54], [0, 0, 0, 1]],
}  # fmt: skip


def written(folder, text):
    (folder / "camera.json").write_text(text if isinstance(text, str) else json.dumps(text))
    return folder / "camera.json"


def test_values(tmp_path):
    camera = read_camera(written(tmp_path, CAMERA))
    np.testing.assert_array_equal(camera.intrinsics, [[600, 0, 320], [0, 601.5, 240], [0, 0, 1]])
    np.testing.assert_array_equal(camera.base_from_camera @ [0, 0, 2, 1], [2.27, 0, 0.54, 1])
    assert (camera.width, camera.height, camera.depth_scale) == (640, 480, 1000.0)


def test_what_is_written_is_read(tmp_path):
    camera = read_camera(written(tmp_path, CAMERA))
    write_camera(tmp_path / "again.json", camera)
    again = read_camera(tmp_path / "again.json")
    for name in ("intrinsics", "base_from_camera", "width", "height", "depth_scale"):
        np.testing.assert_array_equal(getattr(again, name), getattr(camera, name))


@pytest.mark.parametrize("key", KEYS)
def test_missing_key_is_named(tmp_path, key):
    file = written(tmp_path, {k: v for k, v in CAMERA.items() if k != key})
    with pytest.raises(ValueError, match=rf"camera\.json: no key '{key}'"):
        read_camera(file)


def test_depth_scale_is_for_depth(tmp_path):
    file = written(tmp_path, {k: v for k, v in CAMERA.items() if k != "depth_scale"})
    assert read_camera(file, depth=False).width == 640


def mount(row, column, value):
    rows = [list(row) for row in CAMERA["T_base_camera"]]
    rows[row][column] = value
    return rows


@pytest.mark.parametrize(
    "key, value, words",
    [
        ("fx", "600", "not a number"),
        ("fx", None, "not a number"),
        ("fx", True, "not a number"),
        ("fy", -1, "positive"),
        ("cx", float("nan"), "finite"),
        ("width", 640.5, "whole"),
        ("height", 0, "positive"),
        ("depth_scale", 0, "positive"),
        ("T_base_camera", [1, 2], "4 rows of 4"),
        ("T_base_camera", CAMERA["T_base_camera"][:3], "4 rows of 4"),
        ("T_base_camera", mount(0, 0, float("nan")), "4 rows of 4"),
        ("T_base_camera", mount(0, 2, 1.2), "not a rigid transform.*orthonormal"),
        ("T_base_camera", mount(1, 0, 1), "reflection"),
        ("T_base_camera", mount(3, 3, 2), "last row"),
    ],
)
def test_bad_values_name_file_and_key(tmp_path, key, value, words):
    file = written(tmp_path, CAMERA | {key: value})
    with pytest.raises(ValueError, match=rf"camera\.json: '{key}'.*{words}"):
        read_camera(file)


@pytest.mark.parametrize("text, words", [('{"fx": 1,\n oops}', "line 2: not JSON"), ("[1]", "not a JSON object")])
def test_not_a_camera_file(tmp_path, text, words):
    with pytest.raises(ValueError, match=rf"camera\.json.*{words}"):
        read_camera(written(tmp_path, text))


@pytest.mark.parametrize("key", ["k1", "dist_coeffs", "T_base_cam", "Camera.fx"])
def test_unknown_keys_are_refused_by_name(tmp_path, key):
    with pytest.raises(ValueError, match=rf"camera\.json: unknown key '{key}'; known are fx, .*, distortion_model, D"):
        read_camera(written(tmp_path, CAMERA | {key: 1}))


def test_a_key_that_is_there_twice_and_numbers_beyond_all_cameras(tmp_path):
    text = json.dumps(CAMERA)
    with pytest.raises(ValueError, match=r"camera\.json: 'fx' is there twice; remove one of the two"):
        read_camera(written(tmp_path, text.replace('"fy"', '"fx": 300, "fy"')))
    for value in ("1" + "0" * 400, "1e999", "-1e999"):
        with pytest.raises(ValueError, match=r"camera\.json: 'cx' is .*, not a finite number"):
            read_camera(written(tmp_path, text.replace("320.0", value)))


@pytest.mark.parametrize("mark", [b"\xef\xbb\xbf"])
def test_a_byte_order_mark_is_no_content(tmp_path, mark):
    path = written(tmp_path, CAMERA)
    path.write_bytes(mark + path.read_bytes())
    assert read_camera(path).width == 640
