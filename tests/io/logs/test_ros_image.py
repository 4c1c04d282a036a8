import importlib
import struct
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from ebjax.io.logs.ros_bag import open_bag
from ebjax.io.logs.ros_camera_info import calibration_from
from ebjax.io.logs.ros_depth import depth_from, registered
from ebjax.io.logs.ros_image import compressed_from, raw_from
from ebjax.io.logs.ros_message import COMPRESSED, IMAGE, CameraInfo, Header, Image

pytest.importorskip("rosbags.image")
sys.path.insert(0, str(Path(__file__).parent))
made = importlib.import_module("bag_writer")
BagWriter, picture = made.BagWriter, made.picture
HEADER = Header(1, "camera")
RGB = picture(3)
GREY = cv2.cvtColor(RGB, cv2.COLOR_RGB2GRAY)


def message(pixels, encoding, padding=0, big=False, height=None):
    pixels = np.ascontiguousarray(pixels.astype(pixels.dtype.newbyteorder(">")) if big else pixels)
    rows = np.pad(pixels.reshape(len(pixels), -1).view(np.uint8), ((0, 0), (0, padding)))
    return Image(
        HEADER, pixels.shape[1], height or len(pixels), encoding, big, rows.shape[1], memoryview(rows.tobytes())
    )


def bayer(rgb):
    mosaic = rgb[:, :, 1].copy()
    mosaic[::2, ::2], mosaic[1::2, 1::2] = rgb[::2, ::2, 0], rgb[1::2, 1::2, 2]
    return mosaic


def nv12(rgb):
    planes = cv2.cvtColor(rgb, cv2.COLOR_RGB2YUV_I420)
    chroma = planes[len(rgb) :].reshape(2, -1)
    return np.concatenate([planes[: len(rgb)], np.stack([chroma[0], chroma[1]], 1).reshape(-1, rgb.shape[1])])


def alpha(pixels):
    return np.dstack([pixels, np.full(pixels.shape[:2], 255, np.uint8)])


@pytest.mark.parametrize("padding", [0, 6])
@pytest.mark.parametrize(
    "encoding, pixels, tolerance",
    [
        ("rgb8", RGB, 0),
        ("bgr8", RGB[:, :, ::-1], 0),
        ("8UC3", RGB[:, :, ::-1], 0),
        ("rgba8", alpha(RGB), 0),
        ("bgra8", alpha(RGB[:, :, ::-1]), 0),
        ("rgb16", RGB.astype(np.uint16) * 257, 1),
        ("bayer_rggb8", bayer(RGB), 12),
        ("yuv422", cv2.cvtColor(RGB, cv2.COLOR_RGB2YUV_UYVY), 12),
        ("nv12", nv12(RGB), 12),
    ],
)
def test_raw_colour(encoding, pixels, tolerance, padding):
    height = len(RGB) if encoding == "nv12" else None
    rgb = raw_from(message(pixels, encoding, padding, height=height))
    assert rgb.shape == RGB.shape and rgb.dtype == np.uint8
    inner = np.abs(rgb.astype(int) - RGB)[2:-2, 2:-2]
    assert inner.max() <= tolerance


@pytest.mark.parametrize("encoding", ["mono8", "8UC1"])
def test_grey(encoding):
    np.testing.assert_array_equal(raw_from(message(GREY, encoding, 3)), np.dstack([GREY] * 3))


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("bits", [10, 12, 16])
def test_sixteen_bit_grey_is_scaled_by_the_bits_it_uses(bits, big):
    values = GREY.astype(np.uint16) << (bits - 8)
    values[0, 0] = (1 << bits) - 1
    rgb = raw_from(message(values, "mono16", big=big))
    np.testing.assert_array_equal(rgb[1:, :, 0], GREY[1:])
    assert rgb[0, 0, 0] == 255


def test_unknown_and_truncated_raw_images():
    with pytest.raises(ValueError, match="'h264'"):
        raw_from(message(GREY, "h264"))
    cut = Image(HEADER, 32, 24, "rgb8", False, 96, memoryview(bytes(100)))
    with pytest.raises(ValueError, match="truncated image: 100 bytes for 32 x 24"):
        raw_from(cut)


@pytest.mark.parametrize(
    "layout, stored",
    [
        ("jpeg", RGB),
        ("rgb8; jpeg compressed bgr8", RGB),
        ("bgr8; jpeg compressed bgr8", RGB),
        ("rgb8; jpeg compressed ", RGB[:, :, ::-1]),
        ("bgr8; png compressed rgb8", RGB[:, :, ::-1]),
    ],
)
def test_the_channels_of_a_compressed_image(layout, stored):
    content = made.png(stored[:, :, ::-1]) if "png" in layout else made.jpeg(stored)
    rgb = compressed_from(Image(HEADER, 0, 0, layout, False, 0, memoryview(content)))
    assert np.abs(rgb.astype(int) - RGB).max() < 12


def test_compressed_bayer_and_what_is_no_image():
    packed = memoryview(made.png(bayer(RGB)))
    rgb = compressed_from(Image(HEADER, 0, 0, "bayer_rggb8; png compressed ", False, 0, packed))
    assert np.abs(rgb.astype(int) - RGB)[2:-2, 2:-2].max() <= 12
    with pytest.raises(ValueError, match="PNG"):
        compressed_from(Image(HEADER, 0, 0, "png", False, 0, packed[:-20]))
    with pytest.raises(ValueError, match="not an image"):
        compressed_from(Image(HEADER, 0, 0, "jpeg", False, 0, memoryview(b"")))


DEPTH = np.linspace(0.4, 8, 24 * 32).reshape(24, 32).astype(np.float32)
DEPTH[:3] = 0


def test_raw_depth():
    values = np.round(DEPTH * 1000).astype(np.uint16)
    values[5, 5] = 65535
    expected = values / 1000
    expected[5, 5] = 0
    for big in (False, True):
        np.testing.assert_allclose(depth_from(message(values, "16UC1", 4, big), IMAGE), expected, rtol=1e-6)
    metres = DEPTH.copy()
    metres[:2], metres[2] = np.nan, np.inf
    np.testing.assert_array_equal(depth_from(message(metres, "32FC1"), IMAGE), DEPTH)
    with pytest.raises(ValueError, match="depth of encoding 'rgb8'"):
        depth_from(message(RGB, "rgb8"), IMAGE)


@pytest.mark.parametrize("codec", ["png", "rvl"])
@pytest.mark.parametrize("encoding", ["16UC1", "32FC1"])
def test_compressed_depth(encoding, codec):
    content = made.compressed_depth(DEPTH, encoding, codec)
    image = Image(HEADER, 0, 0, f"{encoding}; compressedDepth {codec}", False, 0, memoryview(content))
    depth = depth_from(image, COMPRESSED)
    assert depth.dtype == np.float32 and not depth[:3].any()
    tolerance = 6e-4 if encoding == "16UC1" else 8**2 / 10100
    assert np.abs(depth - DEPTH).max() < tolerance
    cut = Image(HEADER, 0, 0, image.encoding, False, 0, memoryview(content[:-60]))
    with pytest.raises(ValueError, match="truncated"):
        depth_from(cut, COMPRESSED)


def test_depth_as_a_plain_png_and_as_nothing_known():
    content = memoryview(made.png((DEPTH * 1000).astype(np.uint16)))
    assert (
        np.abs(depth_from(Image(HEADER, 0, 0, "16UC1; png compressed", False, 0, content), COMPRESSED) - DEPTH).max()
        < 2e-3
    )
    odd = memoryview(struct.pack("<iff", 0, 0, 0) + bytes(20))
    with pytest.raises(ValueError, match="'16UC1; jpeg' is not known"):
        depth_from(Image(HEADER, 0, 0, "16UC1; jpeg", False, 0, odd), COMPRESSED)


def test_registered_depth_agrees_with_the_planes_it_saw():
    """A wall at 2 m, and a nearer post; the colour camera 0.1 m to the right with twice the focal length."""
    depth = np.full((60, 80), 2.0, np.float32)
    depth[:, 40] = 1.0
    K_depth = np.array([[80.0, 0, 39.5], [0, 80, 29.5], [0, 0, 1]])
    K_colour = np.array([[160.0, 0, 79.5], [0, 160, 59.5], [0, 0, 1]])
    move = np.eye(4)
    move[0, 3] = -0.1
    seen = registered(depth, K_depth, K_colour, (160, 120), move)
    assert seen.shape == (60, 80) and set(np.unique(seen)) == {0, 1, 2}
    assert (seen[:, 32] == 1).all()  # the post: 0.5 px of disparity 80 * 0.1 / 1 = 8 to the left
    assert (seen[:, 76:] == 0).all() and (seen[:, :30] == 2).all()


def camera_info(**fields):
    values = {"model": "plumb_bob", "D": (0,) * 5, "K": made.K, "P": made.P, "binning": (0, 0)} | fields
    values |= {name: tuple(map(float, values[name])) for name in "DKP"}
    return CameraInfo(HEADER, **({"width": 32, "height": 24, "roi": (0, 0, 0, 0)} | values))


def calibration(*infos, image="/camera/image_raw"):
    return calibration_from([(info, 1) for info in infos], "/camera/camera_info", "it", image)


def test_camera_infos():
    bent = camera_info(D=(0.1, 0, 0, 0, 0))
    assert calibration(camera_info()).distortion_model == "pinhole"
    camera = calibration(bent)
    assert camera.distortion_model == "plumb_bob" and camera.distortion == (0.1, 0, 0, 0, 0)
    camera = calibration(bent, image="/camera/image_rect_color")
    assert camera.distortion_model == "pinhole" and camera.intrinsics[0, 0] == 48
    assert calibration(camera_info(K=(0.0,) * 9, P=(0.0,) * 12)) is None and calibration(camera_info(width=0)) is None
    assert calibration() is None
    fisheye = calibration(camera_info(model="equidistant", D=(0.0,) * 4))
    assert fisheye.distortion_model == "equidistant" and fisheye.distortion == (0.0,) * 4
    camera = calibration(camera_info(model="inverse_brown_conrady", D=(0.1, 0, 0, 0, 0)))
    assert camera.distortion_model == "plumb_bob" and "taken as plumb_bob" in camera.notes[0]
    camera = calibration(camera_info(), camera_info(width=33), camera_info(), camera_info(width=0))
    assert camera.width == 32 and "2 different cameras" in camera.notes[0]
    with pytest.raises(
        ValueError, match=r"/camera/camera_info: 'soap_film' is no known distortion model.*--camera FILE"
    ):
        calibration(camera_info(model="soap_film", D=(1.0,)))


def test_a_window_and_bins_move_the_centre():
    camera = calibration(camera_info(roi=(8, 4, 16, 12), binning=(2, 2)))
    assert (camera.width, camera.height) == (8, 6)
    np.testing.assert_allclose(camera.intrinsics, [[25, 0, 3.5], [0, 25, 3.5], [0, 0, 1]])


@pytest.mark.parametrize("joined", [True, False])
def test_depth_of_another_frame_is_moved_or_refused(tmp_path, joined):
    with BagWriter(tmp_path, "mcap") as bag:
        for k in range(3):
            bag.raw("/c/color/image_raw", 1 + k, picture(k), "rgb8", frame="color_optical")
            bag.raw(
                "/c/depth/image_rect_raw", 1 + k, np.full((24, 32), 2000, np.uint16), "16UC1", frame="depth_optical"
            )
            bag.info("/c/color/camera_info", 1 + k, frame="color_optical")
            bag.info("/c/depth/camera_info", 1 + k, frame="depth_optical")
        bag.tf(1, ("base_link", "color_optical", (0, 0, 0.5), made.OPTICAL), static=True)
        if joined:
            bag.tf(1, ("color_optical", "depth_optical", (0.2, 0, 0.1), (1, 0, 0, 0)), static=True)
    log = open_bag(bag.path)
    if not joined:
        assert log.depth is None and "of frame depth_optical, the images of color_optical" in log.missing["depth"]
        return
    depth = log.depth.decode(2)
    assert any("moved into their camera" in note for note in log.notes)
    np.testing.assert_allclose(np.unique(depth[depth > 0]), 2.1, rtol=1e-6)
    assert not depth[:, :3].any() and depth[12, 20] > 0
