import cv2
import numpy as np
import pytest

from ebjax.io.images import BrokenFrame
from ebjax.io.logs.photographs import open_images

Image = pytest.importorskip("PIL.Image")
ImageOps = pytest.importorskip("PIL.ImageOps")
ORIENTATION, TAKEN, FRACTION = 0x0112, 0x9003, 0x9291


def paint(path, shade=0, size=(40, 24), dtype=np.uint8):
    assert cv2.imwrite(str(path), np.full((size[1], size[0], 3), shade, dtype))
    return path


def photograph(path, taken=None, fraction=None, orientation=None, size=(40, 24)):
    """A JPEG with EXIF, written by Pillow, dark on the left."""
    exif = Image.Exif()
    if orientation:
        exif[ORIENTATION] = orientation
    inner = {TAKEN: taken, FRACTION: fraction}
    exif.get_ifd(0x8769).update({tag: value for tag, value in inner.items() if value})
    pixels = np.repeat(np.linspace(0, 255, size[0]).astype(np.uint8)[None, :, None], size[1], axis=0)
    Image.fromarray(np.repeat(pixels, 3, axis=2)).save(path, exif=exif)
    return path


def shade_of(image):
    return round(float(image.mean()) / 10)


def test_images_are_evenly_spaced_in_natural_order(tmp_path):
    for index in (1, 2, 10, 9):
        paint(tmp_path / f"img{index}.jpg", 10 * index)
    log = open_images(tmp_path)
    assert log.kind == "folder of images" and log.colour.names == ("img1.jpg", "img2.jpg", "img9.jpg", "img10.jpg")
    np.testing.assert_array_equal(log.colour.timestamps, [0, 1, 2, 3])
    assert len(log.notes) == 1 and "1 image/s is taken, give --frames-per-s" in log.notes[0]
    assert log.contents == ("4 images (jpg), 40x24", "1 images/s, constant rate", "duration 0:03.000")
    assert [shade_of(log.colour.decode(index)) for index in range(4)] == [1, 2, 9, 10]
    assert set(log.missing) == {"camera", "mount", "odometry", "depth"} and "--camera" in log.missing["camera"]
    given = open_images(tmp_path, frames_per_s=4.0)
    np.testing.assert_array_equal(given.colour.timestamps, [0, 0.25, 0.5, 0.75])
    assert "4 images/s, as given" in given.notes[0]
    with pytest.raises(ValueError, match="--frames-per-s"):
        open_images(tmp_path, frames_per_s=0.0)


@pytest.mark.parametrize(
    "names, times, unit",
    [
        (["1305031102.175304", "1305031102.211214"], [1305031102.175304, 1305031102.211214], "seconds"),
        (["9.5", "10.25"], [9.5, 10.25], "seconds"),
        (["1403636579763555584", "1403636579813555456"], [1403636579.763555584, 1403636579.813555456], "nanoseconds"),
        (["rgb-1305031102175304", "rgb-1305031102211214"], [1305031102.175304, 1305031102.211214], "microseconds"),
    ],
)
def test_names_that_are_times(tmp_path, names, times, unit):
    for index, name in enumerate(names):
        paint(tmp_path / f"{name}.png", 10 * index)
    log = open_images(tmp_path)
    np.testing.assert_allclose(log.colour.timestamps, times, rtol=0, atol=1e-6)
    assert log.notes == (f"{tmp_path}: the times are the file names, in {unit}",)
    assert [shade_of(log.colour.decode(index)) for index in range(2)] == [0, 1]
    np.testing.assert_array_equal(open_images(tmp_path, frames_per_s=2.0).colour.timestamps, [0, 0.5])


def test_names_in_the_order_of_their_times_not_of_their_numbers(tmp_path):
    paint(tmp_path / "10.5.png", 10)
    paint(tmp_path / "10.25.png", 20)
    assert open_images(tmp_path).colour.names == ("10.25.png", "10.5.png")


@pytest.mark.parametrize(
    "names", [["0000000001", "0000000002"], ["1305031102.1", "cover"], ["2023010112345678", "2023010112345700"]]
)
def test_names_that_are_no_times(tmp_path, names):
    for name in names:
        paint(tmp_path / f"{name}.png")
    assert "neither names nor EXIF tell the times" in open_images(tmp_path).notes[0]


def test_two_images_of_one_time_are_refused(tmp_path):
    for name in ("1.5.png", "1.50.png", "2.0.png"):
        paint(tmp_path / name)
    with pytest.raises(ValueError, match=r"1\.5\.png and 1\.50\.png have the same time; remove one"):
        open_images(tmp_path)


def test_times_of_exif(tmp_path):
    photograph(tmp_path / "a1.jpg", "2024:05:01 23:59:59", "25")
    photograph(tmp_path / "a2.jpg", "2024:05:01 23:59:59", "750")
    photograph(tmp_path / "a3.jpg", "2024:05:02 00:00:01")
    log = open_images(tmp_path)
    np.testing.assert_allclose(log.colour.timestamps - 1714607999, [0.25, 0.75, 2])
    assert "times are those of EXIF" in log.notes[0] and "variable rate" in log.contents[1]
    photograph(tmp_path / "a4.jpg", "2024:05:02 00:00:01")
    assert "the times of EXIF do not increase" in open_images(tmp_path).notes[0]
    photograph(tmp_path / "a4.jpg")
    assert "only 3 of 4 images have a time in EXIF" in open_images(tmp_path).notes[0]


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientations_are_left_to_the_calibration(tmp_path, orientation):
    for name in ("1.jpg", "2.jpg"):
        photograph(tmp_path / name, orientation=orientation)
    images = open_images(tmp_path).colour
    stored = np.asarray(Image.open(tmp_path / "1.jpg"))
    turned = np.asarray(ImageOps.exif_transpose(Image.open(tmp_path / "1.jpg")))
    np.testing.assert_array_equal(images.decode(0), stored)
    assert images.size == (40, 24) and images.fitting((40, 24)) is images and images.fitting((400, 240)) is images
    assert len(images.notes) == (orientation > 1)
    if orientation > 1:
        assert (
            f"2 of 2 images looked at have the EXIF orientation {orientation}; they are read as st" in images.notes[0]
        )
    fitted = images.fitting((240, 400))
    assert fitted.sizes == (((24, 40),) if orientation >= 5 else images.sizes)
    np.testing.assert_array_equal(fitted.decode(1), turned if orientation >= 5 else stored)
    assert (fitted is images) == (orientation < 5) and ("read turned so" in "".join(fitted.notes)) == (orientation >= 5)


def test_the_most_frequent_size_is_used(tmp_path):
    for index in range(5):
        paint(tmp_path / f"{index}.png", size=(20, 24) if index == 1 else (40, 24))
    log = open_images(tmp_path)
    assert "4 images of 40x24 pixels are used; 1 of 20x24 are left out" in log.notes[1] and len(log.colour) == 5
    assert log.colour.decode(0).shape == (24, 40, 3)
    with pytest.raises(BrokenFrame, match=r"1\.png: 20x24 pixels, but most images have 40x24"):
        log.colour.decode(1)


def test_depth_images_and_hidden_files_are_left_out(tmp_path):
    for index in range(3):
        paint(tmp_path / f"{index}_colour.png")
        paint(tmp_path / f"{index}_Depth.png", dtype=np.uint16)
        (tmp_path / f"._{index}_colour.png").write_bytes(b"\0")
    log = open_images(tmp_path)
    assert len(log.colour) == 3 and "3 images named 'depth' are left out" in log.notes[0]
    for index in range(3):
        (tmp_path / f"{index}_colour.png").unlink()
    with pytest.raises(ValueError, match="all images are named 'depth'"):
        open_images(tmp_path)


def test_images_of_16_bits_are_noted(tmp_path):
    for index in range(2):
        paint(tmp_path / f"{index}.png", dtype=np.uint16)
    assert "2 of 2 images looked at have more than 8 bits" in open_images(tmp_path).notes[1]


def test_broken_images_are_found_when_decoded(tmp_path):
    for index in range(4):
        paint(tmp_path / f"{index}.jpg")
    (tmp_path / "1.jpg").write_bytes(b"")
    whole = (tmp_path / "2.jpg").read_bytes()
    (tmp_path / "2.jpg").write_bytes(whole[:-20])
    log = open_images(tmp_path)
    assert "1 of 4 images cannot be read" in log.notes[1]
    for index, words in ((1, "empty"), (2, "truncated")):
        with pytest.raises(BrokenFrame, match=rf"{index}\.jpg: .*{words}"):
            log.colour.decode(index)
    assert log.colour.decode(3).shape == (24, 40, 3)


@pytest.mark.parametrize(
    "names, words",
    [
        ([], "no images in it; give a folder"),
        (["0.jpg"], "1 image in it; a run needs two"),
        (["0.txt", "1.txt"], "no images in it"),
        (["empty1.jpg", "empty2.jpg", "0.jpg"], "fewer than two of its 3 images can be read"),
    ],
)
def test_too_few_images(tmp_path, names, words):
    for name in names:
        if name.endswith("txt") or name.startswith("empty"):
            (tmp_path / name).write_text("")
        else:
            paint(tmp_path / name)
    with pytest.raises(ValueError, match=words):
        open_images(tmp_path)


def test_not_a_folder(tmp_path):
    with pytest.raises(ValueError, match=r"nowhere: not a folder"):
        open_images(tmp_path / "nowhere")


def test_opening_decodes_no_jpeg_or_png(tmp_path, monkeypatch):
    paint(tmp_path / "0.jpg")
    paint(tmp_path / "1.png")
    monkeypatch.setattr(cv2, "imdecode", None)
    assert len(open_images(tmp_path).colour) == 2


def test_other_formats_are_decoded_for_their_size(tmp_path):
    for index in range(2):
        paint(tmp_path / f"{index}.bmp")
    log = open_images(tmp_path)
    assert log.contents[0] == "2 images (bmp), 40x24" and log.colour.decode(1).shape == (24, 40, 3)


@pytest.mark.parametrize("name, count", [("f04_hallway_main", 45), ("f09_hallway_main", 41)])
def test_real_photographs(data, name, count):
    log = open_images(data("logs/phone_corridors") / name)
    assert len(log.colour) == count and log.contents[0] == f"{count} images (jpg), 1280x720"
    assert len(log.notes) == 1 and "1 image/s is taken" in log.notes[0]
    assert log.colour.decode(count - 1).shape == (720, 1280, 3)


def test_real_names_that_are_times(data):
    log = open_images(data("corridor_rgbd/rgb"))
    assert len(log.colour) == 172 and log.colour.timestamps[1] == 1000.2 and log.notes[0].endswith("in seconds")
