import numpy as np
import pytest

D = (-0.1, 0.02, 0.001, -0.002, 0.3)


@pytest.mark.parametrize(
    "line, model, distortion, fy",
    [
        ("SIMPLE_PINHOLE 640 480 400 320.5 240.5", "pinhole", (), 400),
        ("PINHOLE 640 480 400 410 320.5 240.5", "pinhole", (), 410),
        ("SIMPLE_RADIAL 640 480 4e2 320.5 240.5 -0.1", "plumb_bob", (-0.1, 0, 0, 0), 400),
        ("SIMPLE_RADIAL 640 480 400 320.5 240.5 0", "pinhole", (), 400),
        ("RADIAL 640 480 400 320.5 240.5 -0.1 0.02", "plumb_bob", (-0.1, 0.02, 0, 0), 400),
        ("OPENCV 640 480 400 410 320.5 240.5 -0.1 0.02 0.001 -0.002", "plumb_bob", D[:4], 410),
        ("OPENCV_FISHEYE 640 480 400 410 320.5 240.5 -0.1 0.02 0.001 -0.002", "equidistant", D[:4], 410),
        ("FULL_OPENCV 640 480 400 410 320.5 240.5 1 2 3 4 5 6 7 8", "rational_polynomial", tuple(range(1, 9)), 410),
        ("SIMPLE_RADIAL_FISHEYE 640 480 400 320.5 240.5 -0.1", "equidistant", (-0.1, 0, 0, 0), 400),
        ("RADIAL_FISHEYE 640 480 400 320.5 240.5 -0.1 0.02", "equidistant", (-0.1, 0.02, 0, 0), 400),
        ("SIMPLE_FISHEYE 640 480 400 320.5 240.5", "equidistant", (0, 0, 0, 0), 400),
    ],
)
def test_colmap(read, line, model, distortion, fy):
    found = read(f"# Camera list with one line of data per camera:\n# Number of cameras: 1\n1 {line}\n")
    np.testing.assert_array_equal(found.intrinsics, [[400, 0, 320], [0, fy, 240], [0, 0, 1]])
    assert (found.width, found.height) == (640, 480)
    assert (found.distortion_model, found.distortion, found.notes) == (model, distortion, ())


def test_several_cameras_of_colmap(read):
    text = "2 PINHOLE 640 480 400 410 320.5 240.5\r\n1 SIMPLE_PINHOLE 800 600 500 400 300\r\n"
    assert read(text).width == 640
    assert "camera 2 is used; the file also has 1" in read(text).notes[0]
    assert read(text, camera="1").width == 800


@pytest.mark.parametrize(
    "text, words",
    [
        ("1 FOV 640 480 400 410 320 240 0.9", "line 1: the model FOV is not read; SIMPLE_PINHOLE, PINHOLE"),
        ("#\n1 THIN_PRISM_FISHEYE 640 480 1 2 3 4 5 6 7 8 9 10 11 12", "line 2: the model THIN_PRISM_FISHEYE is not"),
        ("1 PINHOLE 640 480 400 320 240", "'line 1, fx fy cx cy' has 3 numbers, not 4"),
        ("1 PINHOLE 640 480", "'line 1, fx fy cx cy' has 0 numbers, not 4"),
        ("1 PINHOLE 640 480 400 410 320 x", "'line 1, fx fy cx cy' is 'x', not a number"),
        ("1 PINHOLE 640 480 -400 410 320 240", "'line 1, fx' is -400.0, not a finite positive number"),
    ],
)
def test_faults_of_colmap(read, text, words):
    with pytest.raises(ValueError, match=rf"camera\.calibration:? {words}"):
        read(text)
