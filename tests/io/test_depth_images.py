import cv2
import numpy as np
import pytest

from ebjax.io.depth_images import depth_share, read_depth
from ebjax.io.images import BrokenFrame


def encoded(extension, image):
    return cv2.imencode(extension, image)[1].tobytes()


def test_depth_in_metres_and_missing(tmp_path):
    raw = np.array([[0, 500, 65535], [1, 5000, 65534]], np.uint16)
    (tmp_path / "d.png").write_bytes(encoded(".png", raw))
    depth = read_depth(tmp_path / "d.png", 5000.0, (3, 2))
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, [[0, 0.1, 0], [0.0002, 1, 13.1068]], rtol=1e-6)
    assert depth_share(depth) == pytest.approx(4 / 6)


def test_float_depth_loses_its_nan(tmp_path):
    raw = np.array([[np.nan, 1.5], [np.inf, -1]], np.float32)
    (tmp_path / "d.tiff").write_bytes(encoded(".tiff", raw))
    np.testing.assert_array_equal(read_depth(tmp_path / "d.tiff", 1.0), [[0, 1.5], [0, 0]])


@pytest.mark.parametrize("shape", [(4, 4), (4, 4, 3)])
def test_depth_of_8_bits_is_refused(tmp_path, shape):
    (tmp_path / "d.png").write_bytes(encoded(".png", np.full(shape, 9, np.uint8)))
    with pytest.raises(BrokenFrame, match=r"d\.png: . channel\(s\) of uint8; depth is one channel of 16 bits"):
        read_depth(tmp_path / "d.png", 1000.0)


@pytest.mark.parametrize("per_metre, depth_scale", [(1.0, 1000.0), (1.0, 5000.0), (1000.0, 1000.0), (5000.0, 5000.0)])
@pytest.mark.parametrize("farthest_m", [0.4, 3.0, 12.0])
def test_floats_are_metres_or_in_the_units_of_the_camera_file(tmp_path, per_metre, depth_scale, farthest_m):
    depth_m = np.linspace(0.2, farthest_m, 48, dtype=np.float32).reshape(6, 8)
    (tmp_path / "d.tiff").write_bytes(encoded(".tiff", depth_m * np.float32(per_metre)))
    np.testing.assert_allclose(read_depth(tmp_path / "d.tiff", depth_scale), depth_m, rtol=1e-6)


def test_a_picture_of_depth_in_colours_is_named(tmp_path):
    colours = cv2.applyColorMap(np.arange(48, dtype=np.uint8).reshape(6, 8), cv2.COLORMAP_JET)
    (tmp_path / "d.png").write_bytes(encoded(".png", colours))
    with pytest.raises(BrokenFrame, match="a picture of depth in colours has lost its metres"):
        read_depth(tmp_path / "d.png", 1000.0)
