import json

import cv2
import numpy as np
import pytest

K = [[400, 0, 320], [0, 410, 240], [0, 0, 1]]
D = (-0.1, 0.02, 0.001, -0.002, 0.3)


def stored(tmp_path, ending, **names):
    """What OpenCV itself writes."""
    file = cv2.FileStorage(str(tmp_path / f"opencv.{ending}"), cv2.FILE_STORAGE_WRITE)
    for key, value in names.items():
        file.write(key, np.array(value, float) if isinstance(value, list | tuple) else value)
    file.release()
    return (tmp_path / f"opencv.{ending}").read_text()


@pytest.mark.parametrize("ending", ["yaml", "xml", "json"])
@pytest.mark.parametrize(
    "names",
    [
        ("image_width", "image_height", "camera_matrix", "distortion_coefficients"),
        ("image_Width", "image_Height", "Camera_Matrix", "Distortion_Coefficients"),
        ("width", "height", "cameraMatrix", "distCoeffs"),
        ("width", "height", "K", "D"),
        ("imageWidth", "imageHeight", "mtx", "dist"),
    ],
)
def test_opencv_writes(read, tmp_path, ending, names):
    values = dict(zip(names, (640, 480, K, [D]), strict=True))
    found = read(stored(tmp_path, ending, calibration_time="today", **values))
    np.testing.assert_array_equal(found.intrinsics, K)
    assert (found.width, found.height, found.kind) == (640, 480, "OpenCV YAML, XML or JSON")
    assert (found.distortion_model, found.distortion, found.notes) == ("plumb_bob", D, ())


def test_fisheye_of_opencv(read, tmp_path):
    values = dict(image_width=640, image_height=480, camera_matrix=K, distortion_coefficients=[D[:4]])
    found = read(stored(tmp_path, "yaml", fisheye_model=1, **values))
    assert (found.distortion_model, found.distortion, found.notes) == ("equidistant", D[:4], ())
    found = read(stored(tmp_path, "yaml", fisheye_model=0, **values))
    assert (found.distortion_model, found.notes) == ("plumb_bob", ())
    found = read(stored(tmp_path, "yaml", **values))
    assert found.distortion_model == "plumb_bob"
    assert "taken as k1 k2 p1 p2 of plumb_bob, not as a fisheye's" in found.notes[0]


def test_stereo_of_opencv(read, tmp_path):
    right = [[500, 0, 320], [0, 510, 240], [0, 0, 1]]
    text = stored(tmp_path, "yml", M1=K, D1=[D], M2=right, D2=[[0.0] * 5], width=640, height=480)
    found = read(text)
    np.testing.assert_array_equal(found.intrinsics, K)
    assert "camera 1 is used; the file also has 2" in found.notes[0]
    found = read(text, camera="2")
    np.testing.assert_array_equal(found.intrinsics, right)
    assert found.distortion_model == "pinhole"


DUMPS = {
    "json of rows": json.dumps({"camera_matrix": K, "dist_coeff": [list(D)], "image_size": [640, 480]}),
    "json with a comma too many": '{"mtx": [[400,0,320],[0,410,240],[0,0,1]],\n "dist": [[-0.1,0.02,0.001,-0.002,0.3]],'
    '\n "width": 640, "height": 480,}',
    "yaml in one line": f"{{camera_matrix: {K}, dist_coeff: [{list(D)}], resolution: [640, 480]}}",
    "yaml of tuples": f"K: {K}\nD: {list(D)}\nimage_size: !!python/tuple\n- 640\n- 480\n",
    "yaml with a named size": f"K: {K}\nD: {list(D)}\nimage_size: {{height: 480, width: 640}}\n",
    "yaml over lines": "K:\n- - 400\n  - 0\n  - 320\n- - 0\n  - 410\n  - 240\n- - 0\n  - 0\n  - 1\nwidth: 640\n"
    f"height: 480\nmodel: PINHOLE\ndist_coeffs: {list(D)}\n",
    "words for lists": 'K: "400 0 320 0 410 240 0 0 1"\nD: [-1e-1, 2E-2, 1e-3, -2e-3, 3e-1]\nwidth: 640\nheight: 480\n',
}


@pytest.mark.parametrize("name", DUMPS)
def test_dumps_of_programs(read, name):
    found = read(DUMPS[name])
    np.testing.assert_array_equal(found.intrinsics, K)
    assert (found.width, found.height, found.distortion) == (640, 480, D)


@pytest.mark.parametrize(
    "text, words",
    [
        (f"K: {K}\nD: {list(D)}\n", "no image size; add 'image_width' and 'image_height'"),
        (f"K: {K}\nwidth: 640\nheight: 480\n", "no key 'distortion_coefficients' beside 'K'"),
        (f"D: {list(D)}\nwidth: 640\nheight: 480\n", "no key 'camera_matrix'"),
        (f"K: {np.transpose(K).tolist()}\nD: {list(D)}\nwidth: 640\nheight: 480\n", "'K' is transposed"),
        (f"K: {K[:2]}\nD: {list(D)}\nwidth: 640\nheight: 480\n", "'K' has 6 numbers, not 9"),
        (f"K: {K}\nD: {list(D)}\nwidth: 0\nheight: 480\n", "'width' is 0, not a finite positive number"),
    ],
)
def test_faults_of_opencv(read, text, words):
    with pytest.raises(ValueError, match=rf"camera\.calibration: {words}"):
        read(text)


def test_one_camera_has_no_name(read):
    with pytest.raises(ValueError, match="one camera without a name; do not name a camera"):
        read(f"K: {K}\nD: {list(D)}\nwidth: 640\nheight: 480\n", camera="left")
