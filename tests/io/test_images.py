import struct
import zlib

import cv2
import numpy as np
import pytest

from ebjax.io.images import BrokenFrame, depth_share, read_depth, read_image


@pytest.fixture
def picture():
    rng = np.random.default_rng(0)
    return cv2.GaussianBlur(rng.integers(0, 256, (48, 64, 3), dtype=np.uint8), (5, 5), 2)


def encoded(extension, image, *flags):
    return cv2.imencode(extension, image, flags)[1].tobytes()


def test_channels_are_rgb(tmp_path):
    red = np.zeros((4, 6, 3), np.uint8)
    red[..., 2] = 255
    (tmp_path / "red.png").write_bytes(encoded(".png", red))
    np.testing.assert_array_equal(read_image(tmp_path / "red.png", (6, 4))[0, 0], [255, 0, 0])
    (tmp_path / "grey.png").write_bytes(encoded(".png", red[..., 2]))
    assert read_image(tmp_path / "grey.png").shape == (4, 6, 3)


@pytest.mark.parametrize("flags", [(), (cv2.IMWRITE_JPEG_PROGRESSIVE, 1), (cv2.IMWRITE_JPEG_RST_INTERVAL, 2)])
def test_every_truncation_of_a_jpeg_is_seen(tmp_path, picture, flags, capfd):
    whole = encoded(".jpg", picture, *flags)
    file = tmp_path / "a.jpg"
    file.write_bytes(whole + b"trailing bytes of a phone")
    assert read_image(file).shape == picture.shape
    for length in [1, 2, 3, 20, len(whole) // 2, len(whole) - 1]:
        file.write_bytes(whole[:length])
        with pytest.raises(BrokenFrame, match=r"a\.jpg"):
            read_image(file)
    assert capfd.readouterr().err == ""


def test_a_thumbnail_does_not_hide_a_truncation(tmp_path, picture):
    whole = encoded(".jpg", picture)
    thumbnail = encoded(".jpg", cv2.resize(picture, (16, 12)))
    header = b"\xff\xe1" + struct.pack(">H", len(thumbnail) + 2) + thumbnail
    with_thumbnail = whole[:2] + header + whole[2:]
    file = tmp_path / "a.jpg"
    file.write_bytes(with_thumbnail)
    np.testing.assert_array_equal(read_image(file), cv2.imdecode(np.frombuffer(whole, np.uint8), 1)[..., ::-1])
    file.write_bytes(with_thumbnail[: -len(whole) // 3])
    with pytest.raises(BrokenFrame, match="truncated JPEG"):
        read_image(file)


def test_truncated_and_damaged_png_are_seen_silently(tmp_path, picture, capfd):
    whole = encoded(".png", picture)
    file = tmp_path / "a.png"
    for length in [8, 20, len(whole) // 2, len(whole) - 12, len(whole) - 1]:
        file.write_bytes(whole[:length])
        with pytest.raises(BrokenFrame, match=r"a\.png: truncated or damaged PNG"):
            read_image(file)
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 1
    file.write_bytes(flipped)
    with pytest.raises(BrokenFrame, match="damaged PNG"):
        read_image(file)
    assert capfd.readouterr().err == ""


def test_other_broken_frames_name_the_file(tmp_path, picture):
    (tmp_path / "empty.jpg").write_bytes(b"")
    (tmp_path / "text.png").write_text("not an image")
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "small.png").write_bytes(encoded(".png", picture))
    for name, words in {
        "absent.jpg": "no such file",
        "empty.jpg": "empty",
        "text.png": "not an image",
        "folder.png": "directory",
        "small.png": "64x48 pixels, but the camera has 640x480",
    }.items():
        with pytest.raises(BrokenFrame, match=f"{name}: .*{words}"):
            read_image(tmp_path / name, (640, 480))


def test_a_png_with_a_broken_stream_but_right_checksums(tmp_path):
    def chunk(kind, content):
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = struct.pack(">IIBBBBB", 4, 4, 8, 0, 0, 0, 0)
    content = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", b"junk") + chunk(b"IEND", b"")
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(BrokenFrame, match="not an image"):
        read_image(tmp_path / "a.png")


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
