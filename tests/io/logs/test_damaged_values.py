"""Values in logs that no writer writes: they are left out with a note, or refused in one line."""

import bz2
import contextlib
import importlib
import sqlite3
import sys
from pathlib import Path

import numpy as np
import pytest

from ebjax.io.logs import bag_index
from ebjax.io.logs.open import open_log
from ebjax.io.logs.ros_camera_info import calibration_from
from ebjax.io.logs.ros_image import rows_from
from ebjax.io.logs.ros_message import CameraInfo, Header, Image
from ebjax.io.logs.ros_poses import MOST_M, PoseSamples
from ebjax.io.logs.rtabmap_calibration import cameras_from_blob

sys.path.insert(0, str(Path(__file__).parent))
rtabmap = importlib.import_module("rtabmap_database")


@pytest.fixture
def db3(tmp_path):
    pytest.importorskip("rosbags.highlevel")
    pytest.importorskip("rosbags.image")
    made = importlib.import_module("bag_writer")
    with made.BagWriter(tmp_path, "sqlite3") as writer:
        made.write_run(writer, count=3)
    return next(writer.path.glob("*.db3"))


def change(path, sql, *values):
    with contextlib.closing(sqlite3.connect(path)) as base:
        base.execute(sql, values)
        base.commit()


@pytest.mark.parametrize("column", ["name", "type"])
@pytest.mark.parametrize("value", [None, b"\xff"])
def test_a_topic_without_name_or_type_is_left_out(db3, column, value):
    wanted = "nav_msgs/msg/Odometry"
    with contextlib.closing(sqlite3.connect(db3)) as base:
        declared = base.execute("SELECT sql FROM sqlite_master WHERE name = 'topics'").fetchone()[0]
        base.execute("ALTER TABLE topics RENAME TO old")
        base.execute(declared.replace("NOT NULL", ""))
        base.execute("INSERT INTO topics SELECT * FROM old")
        base.execute(f"UPDATE topics SET {column} = ? WHERE type = ?", (value, wanted))
        base.commit()
    log = open_log(db3)
    assert log.odometry is None and len(log.colour) == 3
    assert any("12 messages of unknown topics are left out" in note for note in log.notes)


def test_a_name_that_is_no_text_is_one_line(db3):
    change(db3, "UPDATE topics SET name = CAST(x'ff' AS TEXT)")
    with pytest.raises(ValueError, match=rf"{db3.name}: ") as error:
        open_log(db3)
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize(
    "text", ["a: 2024-13-45", "rosbag2_bagfile_information: {relative_file_paths: [1]}", "\0", "[" * 999]
)
def test_a_damaged_metadata_yaml_is_passed_over(db3, text):
    (db3.parent / "metadata.yaml").write_text(text)
    assert len(open_log(db3.parent).colour) == 3


@pytest.mark.parametrize("compression", ["bz2", "lz4", "zstd"])
def test_a_chunk_that_unpacks_to_more_than_memory_is_refused(compression, monkeypatch):
    pytest.importorskip("lz4")
    monkeypatch.setattr(bag_index, "MOST_BYTES", 1 << 20)
    pack = {
        "bz2": bz2.compress,
        "lz4": lambda content: importlib.import_module("lz4.frame").compress(content),
        "zstd": lambda content: bag_index.zstd_module().compress(content),
    }[compression]
    most = (1 << 20) - 1
    assert bag_index.decompress(pack(bytes(most)), compression) == bytes(most)
    assert bag_index.decompress(pack(bytes(5 << 20)), compression, 100) == bytes(100)
    with pytest.raises(ValueError, match=f"a damaged {compression} chunk .it unpacks to more than 1 MB"):
        bag_index.decompress(pack(bytes(5 << 20)), compression)


@pytest.mark.parametrize("step", [0, 96, 1000, 2**32 - 1])
def test_the_step_of_an_image_of_one_row_is_of_no_use(step):
    row = np.arange(96, dtype=np.uint8)
    message = Image(Header(0, ""), 32, 1, "rgb8", False, step, memoryview(row.tobytes()))
    np.testing.assert_array_equal(rows_from(message, np.dtype(np.uint8), 3, 1), row.reshape(1, 32, 3))
    with pytest.raises(ValueError, match="truncated image"):
        rows_from(Image(Header(0, ""), 32, 2, "rgb8", False, step, memoryview(row.tobytes())), np.dtype(np.uint8), 3, 2)


@pytest.mark.parametrize("stamp", [float("inf"), 1e308, -1e308, 2**62])
def test_a_stamp_that_is_no_time_is_left_out(tmp_path, stamp):
    path = rtabmap.make_database(tmp_path / "a.db", rtabmap.drive(4))
    change(path, "UPDATE Node SET stamp = ? WHERE id = 4", stamp)
    log = open_log(path)
    np.testing.assert_array_equal(log.colour.timestamps, [101, 102, 103])
    assert any("1 nodes left out, their stamps" in note for note in log.notes)


@pytest.mark.parametrize("far", [1e308, -1e200, MOST_M, float("nan"), float("inf")])
def test_poses_farther_than_the_earth_is_wide_are_left_out(far):
    samples = PoseSamples()
    for k, x in enumerate((0.0, far, 2.0)):
        samples.add(k + 1, k + 1, (x, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    samples.add(4, 4, (0.0, 0.0, 0.0), (1e200, 0.0, 0.0, 0.0))
    trajectory, notes = samples.trajectory("/odom", by_receipt=False)
    np.testing.assert_array_equal(trajectory.poses[:, 0, 3], [0.0, 2.0])
    assert "2 of 4 poses are left out" in notes[0]


@pytest.mark.parametrize("name", ["a#1.db3", "50%.db3", "what?.db3"])
def test_names_that_mean_something_in_an_address(db3, name):
    renamed = db3.rename(db3.with_name(name))
    (renamed.parent / "metadata.yaml").unlink()
    assert len(open_log(renamed).colour) == 3


@pytest.mark.parametrize("focal", [1e-300, 1.0, 1e8, 1e300, float("inf"), float("nan")])
def test_focal_lengths_that_no_camera_has(db3, tmp_path, focal):
    k = np.array([[focal, 0, 16], [0, focal, 12], [0, 0, 1]])
    blob = rtabmap.model(k=k)
    nodes = rtabmap.drive(3)
    for node in nodes:
        node.calibration = blob
    log = open_log(rtabmap.make_database(tmp_path / "a.db", nodes))
    assert log.camera is None and "camera" in log.missing
    assert any("no valid intrinsics" in note for note in log.notes)
    info = CameraInfo(Header(0, ""), 32, 24, "plumb_bob", (), tuple(k.ravel()), (0.0,) * 12, (0, 0), (0, 0, 0, 0))
    with pytest.raises(ValueError, match=r"/info: (focal lengths|numbers that are not finite)"):
        calibration_from([(info, 1)], "/info", "/info of a bag", "/image")


@pytest.mark.parametrize("size", [(-1, 24), (32, -1), (2**31 - 1, 24)])
def test_sizes_that_no_image_has(tmp_path, size):
    nodes = rtabmap.drive(2)
    for node in nodes:
        node.calibration = rtabmap.model(size=size)
    with pytest.raises(ValueError, match=r"a\.db: a calibration of images of .* px; give a database"):
        open_log(rtabmap.make_database(tmp_path / "a.db", nodes))


@pytest.mark.parametrize("width", [float("nan"), float("inf"), -1.0, 1e30])
def test_sizes_of_old_databases(width):
    row = np.frombuffer(rtabmap.old_model(rtabmap.mount()), "<f4").copy()
    row[4] = width
    with pytest.raises(ValueError, match="a calibration of images of"):
        cameras_from_blob(row.tobytes(), (0, 11, 10))


def test_an_error_of_sqlite_is_one_line(tmp_path):
    path = rtabmap.make_database(tmp_path / "a.db", rtabmap.drive(2))
    content = path.read_bytes()
    path.write_bytes(content.replace(b"BEGIN UPDATE Node", b"BEGIN\x1cUPDATE Node"))
    with pytest.raises(ValueError, match=r"a\.db: a damaged database .malformed database schema") as error:
        open_log(path)
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize("name", ["/odd\b\x19name", "/two\nlines", "/a\u2028b"])
def test_names_of_topics_are_printed_in_one_line(db3, name):
    change(db3, "UPDATE topics SET name = ? WHERE name = '/odom'", name)
    log = open_log(db3)
    assert all(line.isprintable() for line in (*log.contents, *log.notes))
