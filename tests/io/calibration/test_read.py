"""Files that are no calibration, and how they are opened."""

import gzip

import numpy as np
import pytest

from ebjax.io.calibration.read import KINDS, read_calibration

GOOD = "K: [[400, 0, 320], [0, 410, 240], [0, 0, 1]]\nD: [-0.1, 0.02, 0.001, -0.002, 0.3]\nwidth: 640\nheight: 480\n"


@pytest.mark.parametrize(
    "content",
    [
        b"just some words",
        b"1.0 0 0 0 0 0 0 1\n2.0 0 0 0 0 0 0 1\n",
        b"root:x:0:0:root:/root:/bin/bash\n",
        b"<html><body>404</body></html>",
        b"[1, 2, 3]",
        b"null",
        b"a: {b: 1}",
        b"---\n---\n",
    ],
)
def test_what_is_not_recognised_lists_the_kinds(read, content):
    with pytest.raises(ValueError, match=r"camera\.calibration: .* these are read: ") as error:
        read(content)
    assert all(kind.name in str(error.value) for kind in KINDS)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "content, words",
    [
        (b"", "an empty file"),
        (b" \n\n", "an empty file"),
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "not text"),
        (gzip.compress(GOOD.encode(), mtime=0)[:30], "not text|damaged gzip"),
        (b'{"fx": 1,\n oops', "line 2: not JSON .*these are read"),
        (b"camera_matrix:\n  data: [1, 2\nwidth: 640\n", "line 3: not YAML .*these are read"),
        (b'{"camera_matrix": 1, "camera_matrix": 2}', "the key 'camera_matrix' is there twice"),
        (b"[" * 100_000, "these are read"),
        (b'<?xml version="1.0"?><opencv_storage>' + b"<a>" * 100_000, "these are read"),
        (b'<?xml version="1.0"?><opencv_storage>' + b"<a>" * 999 + b"</a>" * 999 + b"</opencv_storage>", "these are"),
        (b"%YAML:1.0\n---\na: " + b"[" * 100_000, "line 3: not YAML .more than 100 brackets"),
        (b"%YAML:1.0\n---\nb:c\n" + b"".join(b" " * k + b"a:\n" for k in range(600)), "these are read"),
        (b"\n" * 300_000 + b"x: 1\n", "these are read"),
        (b'{"K\\n": ["\\u2028"], "K": "\\u2028", "D": [0]}', r"'K\\n' is '\\u2028', not a number"),
        (b'{"K": [[1' + b"0" * 500 + b", 0, 0], [0, 1, 0], [0, 0, 1]]}", "'K' is inf, not a finite number"),
        (b"K: !!python/object:os.system 1\n", "line 1: could not determine a constructor"),
    ],
)
def test_one_clear_line(read, content, words):
    with pytest.raises(ValueError, match=rf"camera\.calibration.*({words})") as error:
        read(content)
    assert "\n" not in str(error.value)


def test_no_file_and_a_folder(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_calibration(tmp_path / "none.yaml")
    with pytest.raises(ValueError, match="a folder; give the calibration file itself"):
        read_calibration(tmp_path)


@pytest.mark.parametrize(
    "content",
    [
        GOOD.encode(),
        gzip.compress(GOOD.encode(), mtime=0),
        ("# Kamera für vorne\n" + GOOD).encode("latin-1"),
        GOOD.encode("utf-16"),
        b"\xef\xbb\xbf" + GOOD.encode(),
        GOOD.replace("\n", "\r\n").encode(),
        GOOD.replace("\n", "\r").encode(),
        ("%YAML:1.0\n---\n" + GOOD + "...\n").encode(),
        ("%YAML 1.2\n---\n" + GOOD).encode(),
        ("\n\n--- # first\n" + GOOD).encode(),
    ],
)
def test_ways_to_write_text(read, content):
    found = read(content)
    np.testing.assert_array_equal(found.intrinsics, [[400, 0, 320], [0, 410, 240], [0, 0, 1]])
    assert (found.width, found.height, found.distortion[4]) == (640, 480, 0.3)


def test_size_is_used_only_where_the_file_says_none(read):
    assert read(GOOD, size=(1280, 960)).width == 640
    unsized = GOOD.replace("width: 640\nheight: 480\n", "")
    found = read(unsized, size=(800, 600))
    assert (found.width, found.height) == (800, 600)
    assert "no image size; taken as that of the images, 800 x 600 px" in found.notes[0]
    with pytest.raises(ValueError, match=r"the principal point .* is outside the image of 300 x 200 px"):
        read(unsized, size=(300, 200))


def test_a_long_table_is_refused_at_once(read):
    with pytest.raises(ValueError, match="longer than any calibration"):
        read("1.5 2.5 3.5\n" * 200_000)
