import struct
import zlib

import cv2
import numpy as np
import pytest

from ebjax.io.images import BrokenFrame, read_both, read_image, same_shape

Image = pytest.importorskip("PIL.Image")
ImageOps = pytest.importorskip("PIL.ImageOps")
ORIENTATION = 0x0112


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


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif", "a.webp"])
def test_pixels_are_as_stored_unless_only_turned_they_fit(tmp_path, picture, name, orientation):
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    Image.fromarray(picture).save(tmp_path / name, exif=exif, lossless=True)
    # Pillow turns a TIFF by itself.
    stored = np.asarray(Image.open(tmp_path / name)) if name == "a.jpg" else picture
    plain = Image.fromarray(stored)
    plain.getexif()[ORIENTATION] = orientation
    turned = np.asarray(ImageOps.exif_transpose(plain))
    for size in (None, (64, 48)):
        np.testing.assert_array_equal(read_image(tmp_path / name, size), stored)
    if orientation >= 5:
        np.testing.assert_array_equal(read_image(tmp_path / name, (48, 64)), turned)
    else:
        with pytest.raises(BrokenFrame, match="64x48 pixels, but the camera has 48x64"):
            read_image(tmp_path / name, (48, 64))


@pytest.mark.parametrize("orientation", [2, 3, 6])
def test_a_square_image_is_as_stored(tmp_path, picture, orientation):
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    Image.fromarray(picture[:, :48]).save(tmp_path / "a.png", exif=exif)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png", (48, 48)), picture[:, :48])


@pytest.mark.parametrize(
    "name, mode", [("a.png", "P"), ("a.png", "LA"), ("a.png", "1"), ("a.png", "L"), ("a.jpg", "CMYK"), ("a.tif", "P")]
)
def test_every_kind_of_pixels_as_pillow_sees_them(tmp_path, picture, name, mode):
    Image.fromarray(picture).convert(mode).save(tmp_path / name)
    seen = np.asarray(Image.open(tmp_path / name).convert("RGB"))
    assert np.abs(read_image(tmp_path / name).astype(int) - seen).max() <= 1


def test_colours_under_alpha_are_read_as_they_are(tmp_path, picture):
    alpha = np.where(np.arange(64) < 20, 0, 200).astype(np.uint8)[None].repeat(48, axis=0)
    for name in ("a.png", "a.webp"):
        Image.fromarray(np.dstack([picture, alpha])).save(tmp_path / name, lossless=True, exact=True)
        np.testing.assert_array_equal(read_image(tmp_path / name), picture)


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_16_bits_are_scaled_by_those_in_use(tmp_path, picture, bits):
    grey = (picture[..., 0].astype(np.uint16) * 257) >> (16 - bits)
    grey[0, 0] = (1 << bits) - 1
    cv2.imwrite(str(tmp_path / "low.png"), grey)
    np.testing.assert_array_equal(read_image(tmp_path / "low.png")[..., 0], grey >> (bits - 8))
    cv2.imwrite(str(tmp_path / "high.png"), grey << (16 - bits))
    np.testing.assert_array_equal(read_image(tmp_path / "high.png")[..., 1], grey >> (bits - 8))
    np.testing.assert_array_equal(read_image(tmp_path / "low.png", bits=16)[..., 2], grey >> 8)


def test_two_images_of_a_pair_share_their_bits(tmp_path):
    for name, value in (("dark.png", 200), ("bright.png", 4000)):
        cv2.imwrite(str(tmp_path / name), np.full((4, 6), value, np.uint16))
    dark, bright = read_both(tmp_path / "dark.png", tmp_path / "bright.png")
    assert dark[0, 0, 0] == 200 >> 4 and bright[0, 0, 0] == 4000 >> 4


HEIC = b"\0\0\0\x18ftypheic\0\0\0\0mif1heic"


@pytest.mark.parametrize(
    "name, content, words",
    [
        ("a.heic", HEIC, r"a HEIC image, which is not read; convert it to PNG.*magick .*a\.heic a\.png"),
        ("a.jpg", HEIC, "a HEIC image, which is not read"),
        ("a b.cr2", b"II*\0\x10\0\0\0CR\2\0", r"a camera's raw picture.*magick '.*a b\.cr2' 'a b\.png'"),
        ("a.nef", b"MM\0*\0\0\0\x08", "a camera's raw picture, which is not read"),
        ("a.exr", b"\x76\x2f\x31\x01\2\0\0\0", "an OpenEXR image, which is not read"),
        ("a.png", b"version https://git-lfs.github.com/spec/v1\n", "a pointer of Git LFS.* git lfs pull"),
        ("a.png", b"<!DOCTYPE html>", "a web page"),
        ("a.npy", b"\x93NUMPY\1\0", "a NumPy array"),
        ("a.png", b"\x89PNG\r\n\x1a\n", "truncated or damaged PNG"),
        ("a.bmp", b"BM6\0\0\0", "not an image that OpenCV can decode"),
    ],
)
def test_what_is_no_readable_image_is_named(tmp_path, capfd, name, content, words):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BrokenFrame, match=rf"{name}: {words}") as raised:
        read_image(tmp_path / name)
    assert "\n" not in str(raised.value) and capfd.readouterr().err == ""


def test_a_raw_picture_is_not_taken_for_its_thumbnail(tmp_path, picture):
    Image.fromarray(picture).save(tmp_path / "a.tif", tiffinfo={50706: b"\1\4\0\0"})
    with pytest.raises(BrokenFrame, match="a camera's raw picture"):
        read_image(tmp_path / "a.tif")


@pytest.mark.parametrize("name", ["a.png", "a.webp", "a.gif"])
def test_an_animation_is_no_image(tmp_path, picture, name):
    frames = [Image.fromarray(np.roll(picture, k)) for k in range(3)]
    frames[0].save(tmp_path / name, save_all=True, append_images=frames[1:])
    with pytest.raises(BrokenFrame, match="an animation, not one image; save its frames"):
        read_image(tmp_path / name)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_floats_are_no_colours(tmp_path, capfd, dtype):
    cv2.imwrite(str(tmp_path / "a.tif"), np.full((4, 6), 0.5, dtype))
    with pytest.raises(BrokenFrame, match=r"a\.tif: pixels of float\d\d, .*8 or 16 bits"):
        read_image(tmp_path / "a.tif")
    assert capfd.readouterr().err == ""


def test_sizes_from_one_pixel_to_more_than_can_be_decoded(tmp_path):
    for width, height in ((1, 1), (2, 2), (65500, 2)):
        Image.new("RGB", (width, height), (9, 8, 7)).save(tmp_path / "a.png")
        assert read_image(tmp_path / "a.png", (width, height))[-1, -1].tolist() == [9, 8, 7]

    def chunk(kind, content):
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 70000, 70000, 8, 2, 0, 0, 0))
    (tmp_path / "a.png").write_bytes(
        b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(bytes(9))) + chunk(b"IEND", b"")
    )
    with pytest.raises(BrokenFrame, match=r"a\.png: 70000x70000 pixels, more than \d+; give it smaller"):
        read_image(tmp_path / "a.png")


def test_names_and_extensions_do_not_matter(tmp_path, picture):
    (tmp_path / "a.png").write_bytes(encoded(".png", picture))
    for name in ("b.jpg", "Größe 1.png", "c"):
        (tmp_path / name).symlink_to(tmp_path / "a.png")
        np.testing.assert_array_equal(read_image(tmp_path / name), picture[..., ::-1])
    (tmp_path / "lost.png").symlink_to(tmp_path / "nowhere.png")
    with pytest.raises(BrokenFrame, match=r"lost\.png: no such file"):
        read_image(tmp_path / "lost.png")


@pytest.mark.parametrize(
    "a, b, same",
    [
        ((640, 480), (320, 240), True),
        ((641, 480), (320, 240), True),
        ((640, 480), (640, 400), False),
        ((4, 3), (3, 4), False),
    ],
)
def test_shapes(a, b, same):
    assert same_shape(a, b) == same_shape(b, a) == same
