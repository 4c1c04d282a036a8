"""Small files that stand for more than memory holds, and numbers beyond those of any table or camera."""

import gzip
import json
import struct
import zlib

import cv2
import numpy as np
import pytest

from ebjax.io import text
from ebjax.io.calibration.read import read_calibration
from ebjax.io.camera_file import read_camera
from ebjax.io.image_header import read_header
from ebjax.io.mask import read_mask
from ebjax.io.pairs import read_pairs
from ebjax.io.poses import rigid_fault
from ebjax.io.trajectory import read as read_trajectory
from ebjax.posegraph import g2o_lines
from ebjax.posegraph.g2o_lines import parse_lines

CAMERA = {"fx": 30, "fy": 30, "cx": 15, "cy": 11, "width": 32, "height": 24, "depth_scale": 1000}
CAMERA["T_base_camera"] = [[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 1], [0, 0, 0, 1]]


@pytest.mark.parametrize("read", [text.read_text, g2o_lines.read_text, read_calibration, read_camera])
@pytest.mark.parametrize("fill", [b"\0", b"1 ", b"[[\n"])
def test_gzip_unpacks_up_to_a_bound(tmp_path, monkeypatch, read, fill):
    monkeypatch.setattr(text, "MOST_BYTES", 1 << 16)
    monkeypatch.setattr(g2o_lines, "MOST_BYTES", 1 << 16)
    (tmp_path / "a.gz").write_bytes(gzip.compress(fill * (1 << 14)) * 10)
    with pytest.raises(ValueError, match=r"a\.gz: unpacks to more than 0 MB; unpack it"):
        read(tmp_path / "a.gz")


def test_text_below_the_bound_is_read(tmp_path, monkeypatch):
    monkeypatch.setattr(text, "MOST_BYTES", 40)
    (tmp_path / "a.gz").write_bytes(gzip.compress(b"1 2 3\n" * 6))
    assert text.read_text(tmp_path / "a.gz") == "1 2 3\n" * 6
    (tmp_path / "a.txt").write_text("1 2 3\n" * 60)
    assert len(text.read_text(tmp_path / "a.txt")) == 360


@pytest.mark.parametrize("content", [b"1 2\n\0\n", b"\0" * 100, "a\0b".encode("utf-16")])
def test_a_zero_byte_is_no_text(tmp_path, content):
    (tmp_path / "a.txt").write_bytes(content)
    for read in (text.read_text, g2o_lines.read_text):
        with pytest.raises(ValueError, match=r"a\.txt: not a text file"):
            read(tmp_path / "a.txt")


@pytest.mark.parametrize(
    "field, words",
    [
        ("1e30", r"1e30 is larger than 1e\+30"),
        ("-1e308", r"-1e308 is larger than 1e\+30"),
        ("1e999", "1e999 is not a finite number"),
        ("x" * 5000, "'x{80}' is not a number"),
    ],
)
def test_numbers_of_no_table(field, words):
    with pytest.raises(ValueError, match=f"a.txt line 3: {words}; correct or remove the line"):
        text.floats("a.txt", 3, ["1.5", field])
    assert text.floats("a.txt", 3, ["1e29", "-1403636579763555584"]) == [1e29, -1403636579763555584.0]


@pytest.mark.parametrize("key, value", [("fx", 10**400), ("cx", "9" * 5000), ("T_base_camera", 1e200)])
def test_numbers_of_no_camera(tmp_path, key, value):
    whole = value if key != "T_base_camera" else [[value] * 4] * 4
    content = json.dumps(CAMERA | {key: whole}).replace(f'"{value}"', str(value))
    (tmp_path / "camera.json").write_text(content)
    with pytest.raises(ValueError, match=rf"camera\.json: '{key}'") as error:
        read_camera(tmp_path / "camera.json")
    assert len(str(error.value)) < 400


@pytest.mark.parametrize("size", [1e2, 1e200, 1e308, float("inf"), float("nan")])
def test_no_rotation_has_large_numbers(size):
    pose = np.eye(4)
    pose[0, 1] = size
    assert "is not a rotation" in rigid_fault(pose)


def test_brackets_in_camera_json(tmp_path):
    (tmp_path / "camera.json").write_text('{"D":' + "[" * 100_000)
    with pytest.raises(ValueError, match=r"camera\.json line 1: not JSON \(more than 100 brackets"):
        read_camera(tmp_path / "camera.json")


@pytest.mark.parametrize("values", [{"quad": [[10**400, 1]] * 4}, {"H_a_to_b": [[1e200] * 3] * 3}])
def test_numbers_of_no_pair(tmp_path, values):
    (tmp_path / "one").mkdir()
    good = {"quad": [[0, 0], [9, 0], [9, 9], [0, 9]], "H_a_to_b": np.eye(3).tolist()}
    (tmp_path / "one" / "gt.json").write_text(json.dumps(good | values))
    with pytest.raises(ValueError, match=r"gt\.json: give \"quad\""):
        read_pairs(tmp_path)


@pytest.mark.parametrize("brightest", [1.0, 1e38, 1e308, float("inf")])
def test_masks_of_floats(tmp_path, brightest):
    mask = np.full((24, 32), brightest)
    mask[:8] = 0
    cv2.imwrite(str(tmp_path / "mask.tiff"), mask)
    ignored, _ = read_mask(tmp_path / "mask.tiff", (32, 24))
    np.testing.assert_array_equal(ignored, np.repeat([True, False], [8, 16])[:, None].repeat(32, 1))


def test_a_chunk_of_a_png_may_say_that_it_is_as_large_as_it_likes(tmp_path):
    whole = cv2.imencode(".png", np.zeros((24, 32, 3), np.uint8))[1].tobytes()
    chunk = struct.pack(">I", 2**32 - 1) + b"eXIf" + bytes(40) + struct.pack(">I", zlib.crc32(b"eXIf" + bytes(40)))
    end = whole.index(b"IEND") - 4
    (tmp_path / "a.png").write_bytes(whole[:end] + chunk + whole[end:])
    header = read_header(tmp_path / "a.png")
    assert header is None or (header.width, header.height) == (32, 24)


def test_a_field_that_is_longer_than_csv_reads(tmp_path):
    (tmp_path / "a.csv").write_text('"1.5",2,3,0,0,0,0,1\n"' + "9" * 200_000 + '",2,3,0,0,0,0,1\n')
    with pytest.raises(ValueError, match=r"a\.csv") as error:
        read_trajectory(tmp_path / "a.csv")
    assert len(str(error.value)) < 600


@pytest.mark.parametrize("number", ["1e308", "-1e200", "nan", "inf"])
@pytest.mark.parametrize("place", [2, 8, 14])
def test_numbers_of_no_graph(tmp_path, number, place):
    tokens = "VERTEX_SE2 0 0 0 0 EDGE_SE2 0 1 1 0 0 9 0 0 9 0 9".split()
    tokens[place] = number
    (tmp_path / "a.g2o").write_text(" ".join(tokens[:5]) + "\nVERTEX_SE2 1 1 0 0\n" + " ".join(tokens[5:]) + "\n")
    with pytest.raises(ValueError, match=r"a\.g2o:[13]: .* is not finite, or larger than 1e\+100; correct the line"):
        parse_lines((tmp_path / "a.g2o").read_text(), str(tmp_path / "a.g2o"))
