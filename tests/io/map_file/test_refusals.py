"""What is no map is refused in one line that says what it is."""

import contextlib
import importlib
import os
import sqlite3
import sys
from pathlib import Path

import pytest

from ebjax.io.map_file.faults import Damaged
from ebjax.io.map_file.file import MapFile
from ebjax.io.map_file.repair import repair

sys.path.insert(0, str(Path(__file__).parent))
filled = importlib.import_module("small_maps").filled


def database(path, *statements):
    with contextlib.closing(sqlite3.connect(path)) as made:
        for statement in statements:
            made.execute(statement)
        made.commit()


def refused(path, words, kind=ValueError):
    """Both ways to open say the same, and leave nothing behind."""
    before = sorted(os.listdir(path.parent)) if path.parent.is_dir() else None
    for write in (False, True):
        with pytest.raises(kind, match=words) as fault:
            MapFile.open(path, write=write)
        assert str(path) in str(fault.value) and "\n" not in str(fault.value)
    assert before is None or sorted(os.listdir(path.parent)) == before


def test_files_of_others(tmp_path):
    nodes = [f"CREATE TABLE {name}(id INTEGER)" for name in ("Admin", "Node", "Link", "Data")]
    database(tmp_path / "rtabmap.db", *nodes)
    database(tmp_path / "bag.db3", "CREATE TABLE topics(id INTEGER)", "CREATE TABLE messages(id INTEGER)")
    database(tmp_path / "places.sqlite", "CREATE TABLE moz_places(id INTEGER)")
    refused(tmp_path / "rtabmap.db", "an RTAB-Map database, not a map of ebjax; give it as the log")
    refused(tmp_path / "bag.db3", "a ROS 2 bag, not a map of ebjax; give it as the log")
    refused(tmp_path / "places.sqlite", "an SQLite file of another program, not a map of ebjax")
    for name, content in (("a.txt", b"x y theta\n" * 100), ("short.ebmap", b"SQLi"), ("zeros.ebmap", bytes(9000))):
        (tmp_path / name).write_bytes(content)
        refused(
            tmp_path / name, "not a map, or its first bytes are damaged; if it was one, save .* with --repair", Damaged
        )
        with pytest.raises(
            ValueError, match="no row of a map can be read in it; it was none, or nothing of it is left"
        ):
            repair(tmp_path / name, tmp_path / "out.ebmap")
    for name in ("rtabmap.db", "bag.db3", "places.sqlite"):
        with pytest.raises(ValueError, match="no row of a map can be read in it"):
            repair(tmp_path / name, tmp_path / "out.ebmap")
    assert not (tmp_path / "out.ebmap").exists()


def test_no_file_at_all(tmp_path):
    (tmp_path / "empty.ebmap").touch()
    os.mkfifo(tmp_path / "pipe.ebmap")
    refused(tmp_path / "empty.ebmap", "is empty; remove it, or name a map that was written with --map")
    refused(tmp_path, "is a folder; name a map's file")
    refused(tmp_path / "none.ebmap", "no such file; name a map that was written with --map")
    refused(tmp_path / "no" / "folder.ebmap", "no such file; name a map that was written with --map")
    refused(tmp_path / "pipe.ebmap", "not a file; name a map's file")


@pytest.mark.parametrize("version", [2, 7, 1000])
def test_a_newer_version(tmp_path, version):
    path = filled(tmp_path / "a.ebmap", 3)
    database(path, f"PRAGMA user_version = {version}")
    refused(path, f"a map of version {version}, of a newer ebjax; this one reads version 1, update it")


def test_a_head_that_is_damaged(tmp_path):
    path = filled(tmp_path / "a.ebmap", 3)
    database(path, "PRAGMA user_version = 0")
    refused(path, "a map whose first bytes are damaged; save what can be read into a new file with --repair", Damaged)
    database(path, "PRAGMA user_version = 1", "PRAGMA application_id = 5")
    refused(path, "a map whose first bytes are damaged", Damaged)
    database(path, f"PRAGMA application_id = {0x45426D70}", "DROP TABLE settled")
    refused(path, "a map whose first bytes are damaged", Damaged)


@pytest.mark.parametrize("size", [4096, 9000, 40_000])
def test_a_truncated_file(tmp_path, size):
    path = filled(tmp_path / "a.ebmap", 20, 5_000)
    whole = path.stat().st_size
    os.truncate(path, size)
    refused(path, f"truncated, {size} of {whole} bytes; copy it again, or save what can be read", Damaged)
