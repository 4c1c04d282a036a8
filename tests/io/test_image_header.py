import struct

import cv2
import numpy as np
import pytest

from ebjax.io.exif import Exif, read_exif, without_orientation
from ebjax.io.image_header import Header, read_header

Image = pytest.importorskip("PIL.Image")
ORIENTATION, TAKEN, FRACTION = 0x0112, 0x9003, 0x9291


def paint(path, dtype=np.uint8):
    """A picture of 7 x 5 px, written by OpenCV."""
    assert cv2.imwrite(str(path), np.full((5, 7, 3), 90, dtype))
    return path


def save(path, orientation, mode="RGB", **options):
    """A picture of 7 x 5 px with an EXIF orientation, written by Pillow."""
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    Image.new(mode, (7, 5)).save(path, exif=exif, **options)
    return path


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif", "a.webp"])
def test_orientation_of_every_format(tmp_path, name, orientation):
    header = read_header(save(tmp_path / name, orientation))
    assert header.size == (7, 5) and header.bits == 8 and header.exif.orientation == orientation
    assert header.turned_size == ((5, 7) if orientation >= 5 else (7, 5))


@pytest.mark.parametrize(
    "name, mode, alpha",
    [
        ("a.png", "RGBA", True),
        ("a.png", "LA", True),
        ("a.png", "P", False),
        ("a.webp", "RGBA", True),
        ("a.tif", "L", False),
    ],
)
def test_alpha(tmp_path, name, mode, alpha):
    Image.new(mode, (7, 5)).save(tmp_path / name, lossless=True)
    assert read_header(tmp_path / name).alpha == alpha


@pytest.mark.parametrize("name", ["a.png", "a.webp", "a.gif"])
def test_animations(tmp_path, name):
    frames = [Image.new("RGB", (7, 5), colour) for colour in ("red", "blue", "green")]
    frames[0].save(tmp_path / name, save_all=True, append_images=frames[1:])
    assert read_header(tmp_path / name).animated
    frames[0].save(tmp_path / name)
    assert not read_header(tmp_path / name).animated


def test_floats_and_big_endian_of_tiff(tmp_path):
    assert cv2.imwrite(str(tmp_path / "a.tif"), np.zeros((5, 7), np.float32))
    header = read_header(tmp_path / "a.tif")
    assert header.floats and header.bits == 32 and header.size == (7, 5)
    Image.new("I;16B", (7, 5)).save(tmp_path / "b.tif")
    assert read_header(tmp_path / "b.tif").bits == 16


def test_a_tiff_whose_orientation_is_taken_out_keeps_all_else(tmp_path):
    content = save(tmp_path / "a.tif", 6).read_bytes()
    changed = without_orientation(content)
    assert read_exif(changed) == Exif() and len(changed) == len(content)
    assert sum(a != b for a, b in zip(content, changed, strict=True)) == 1
    assert without_orientation(changed) is changed and without_orientation(b"") == b""


def test_headers(tmp_path):
    assert read_header(paint(tmp_path / "a.png", np.uint16)) == Header(7, 5, 16)
    assert read_header(paint(tmp_path / "a.jpg")) == Header(7, 5, 8)
    cv2.imwrite(str(tmp_path / "b.jpg"), np.zeros((5, 7), np.uint8), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])
    assert read_header(tmp_path / "b.jpg") == Header(7, 5, 8)


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif", "a.webp"])
def test_a_damaged_header_is_no_header(tmp_path, name):
    path = save(tmp_path / name, 6)
    whole = path.read_bytes()
    for end in range(20):
        path.write_bytes(whole[:end])
        assert read_header(path) is None
    random = np.random.default_rng(0)
    for _ in range(200):
        content = bytearray(whole)
        content[random.integers(2, min(150, len(whole)))] = random.integers(256)
        path.write_bytes(content)
        read_header(path)


def test_exif_of_both_byte_orders():
    for order, mark in (("<", b"II"), (">", b"MM")):
        pack = lambda form, *values, order=order: struct.pack(order + form, *values)  # noqa: E731
        first = pack("H", 2) + pack("HHIHH", ORIENTATION, 3, 1, 6, 0) + pack("HHII", 0x8769, 4, 1, 38) + pack("I", 0)
        inner = pack("H", 2) + pack("HHII", TAKEN, 2, 20, 68) + pack("HHI4s", FRACTION, 2, 3, b"50\0\0") + pack("I", 0)
        tiff = mark + pack("HI", 42, 8) + first + inner + b"1970:01:02 00:00:01\0"
        assert read_exif(tiff) == Exif(6, 86401.5)
        assert [read_exif(tiff[:end]).taken_s for end in range(50)] == [None] * 50
    assert read_exif(b"") == read_exif(b"XX" + bytes(50)) == Exif()
    assert read_exif(tiff.replace(b"1970:01:02", b"0000:00:00")) == Exif(6, None)
