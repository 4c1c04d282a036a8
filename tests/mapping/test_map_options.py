import os
import re
import shutil
from pathlib import Path

import pytest
from told_maps import add_session

from ebjax.io.map_file.file import MapFile
from ebjax.mapping.map_options import MapOptions, check_map_options, look_after
from ebjax.slam.config import PipelineConfig


@pytest.fixture
def building(tmp_path):
    """A map of two sessions, the second not finished."""
    path = tmp_path / "building.ebmap"
    with MapFile.create(path, {}) as kept:
        add_session(kept, "monday")
        add_session(kept, "tuesday", 6, finish=False)
    return path


def done(path, out=Path("out"), **asked):
    return look_after(path, MapOptions(map=path, **asked), out, 0.02, PipelineConfig())


@pytest.mark.parametrize(
    ("options", "log", "words"),
    [
        (MapOptions(export=True), None, ["--export is for a map", "--map FILE.ebmap"]),
        (MapOptions(forget=1), Path("log"), ["--forget is for a map"]),
        (MapOptions(map=Path("m"), export=True, repair=True), None, ["--export and --repair", "one of them at a time"]),
        (MapOptions(map=Path("m"), forget=0, views=False), None, ["--forget and --no-views"]),
        (MapOptions(map=Path("m"), redescribe=True, repair=True), None, ["--redescribe and --repair"]),
        (MapOptions(redescribe=True), None, ["--redescribe is for a map", "--map FILE.ebmap"]),
        (MapOptions(map=Path("m"), redescribe=True), Path("log"), ["--redescribe is for the map alone"]),
        (MapOptions(map=Path("m"), views=False), Path("log"), ["--no-views is for the map alone", "leave log out"]),
        (MapOptions(start=(0.0, 0.0, 0.0)), Path("log"), ["--start X Y HEADING", "give --localise too"]),
        (MapOptions(map=Path("m"), localise=True), None, ["give LOG --map FILE.ebmap --localise"]),
        (MapOptions(localise=True), Path("log"), ["give LOG --map FILE.ebmap --localise"]),
        (MapOptions(map=Path("m"), localise=True, export=True), Path("log"), ["--localise and --export"]),
    ],
)
def test_what_does_not_go_together_is_refused(options, log, words):
    with pytest.raises(ValueError) as refused:
        check_map_options(options, log)
    assert all(word in str(refused.value) for word in words), refused.value


def test_a_run_with_a_map_or_either_alone_goes(tmp_path):
    for options, log in ((MapOptions(), None), (MapOptions(), Path("log")), (MapOptions(map=Path("m")), Path("log"))):
        check_map_options(options, log)
    check_map_options(MapOptions(map=Path("m"), forget=3), None)


@pytest.mark.parametrize("asked", [{}, {"export": True}, {"forget": 1}, {"views": False}, {"redescribe": True}])
def test_a_map_that_is_not_there_is_named(tmp_path, asked):
    with pytest.raises(ValueError, match=r"there is no such map; a run begins it: python -m ebjax\.slam LOG --map"):
        done(tmp_path / "none.ebmap", **asked)
    assert not list(tmp_path.iterdir())


def test_a_map_says_what_is_in_it(building):
    before = building.read_bytes()
    first, monday, tuesday = done(building)
    assert "2 sessions, 14 keyframes" in first and "1 candidate" not in first and "2 candidates not decided" in first
    assert re.search(r"session 1, monday: begun .*, 8 keyframes, .* m, finished", monday)
    assert "6 keyframes" in tuesday and "not finished" in tuesday
    assert building.read_bytes() == before


def test_an_export_names_its_files(building, tmp_path):
    lines = done(building, tmp_path / "out", export=True)
    assert lines[-1].startswith(f"{tmp_path / 'out'}: floor_map.png, ")
    assert all((tmp_path / "out" / name).is_file() for name in lines[-1].split(": ")[1].split(", "))


def test_a_session_is_forgotten_and_another_is_named_where_there_is_none(building):
    with pytest.raises(ValueError, match="holds no session 3; it has 1, 2"):
        done(building, forget=3)
    done(building, forget=2)
    assert "1 session, 8 keyframes" in done(building)[0]


def test_views_are_dropped(building, tmp_path):
    done(building, forget=2)
    done(building, views=False)
    assert any("without a floor view" in line for line in done(building, tmp_path / "out", export=True))


def test_what_is_left_of_a_damaged_map_goes_on(building):
    content = bytearray(building.read_bytes())
    content[len(content) // 2 : len(content) // 2 + 4] = b"\0ow!"
    building.write_bytes(bytes(content))
    lines = done(building, repair=True)
    new = building.with_name("building.repaired.ebmap")
    assert lines[-1] == f"go on with --map {new}"
    assert "keyframes" in done(new)[0]


def test_another_file_is_no_map(tmp_path):
    other = tmp_path / "other.ebmap"
    shutil.copy(os.__file__, other)
    with pytest.raises(ValueError, match=r"other\.ebmap"):
        done(other)
