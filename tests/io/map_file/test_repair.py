"""Damage is named where it is met, never read as if it were data, and all else is saved into a new file."""

import importlib
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from ebjax.io.map_file.faults import Damaged
from ebjax.io.map_file.file import MapFile
from ebjax.io.map_file.repair import named, repair

sys.path.insert(0, str(Path(__file__).parent))
made = importlib.import_module("small_maps")
FACTS, arrays_of, assert_arrays, assert_filled, edge_of, filled, keyframe_of, solved = (
    getattr(made, name)
    for name in "FACTS arrays_of assert_arrays assert_filled edge_of filled keyframe_of solved".split()
)
PAGE = 4096


def changed(path, start, content):
    with open(path, "r+b") as file:
        file.seek(start)
        file.write(content)


def flip(path, content, at):
    """Changes a byte wherever the content stands: SQLite leaves copies in pages that it no longer reads."""
    whole = path.read_bytes()
    assert content in whole
    path.write_bytes(whole.replace(content, content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :]))


def test_a_sound_map_is_saved_whole(tmp_path):
    path = filled(tmp_path / "a.ebmap", 20, 9_000)
    report = repair(path, tmp_path / "out.ebmap")
    assert not report.lost and report.summary().endswith(
        "out.ebmap: saved 1 sessions, 20 keyframes, 20 frames, 37 edges; nothing is lost"
    )
    for file in (path, report.out):
        with MapFile.open(file, write=False) as kept:
            assert_filled(kept, 20, 9_000)
    with pytest.raises(FileExistsError, match="is there already"):
        repair(path, report.out)
    with MapFile.open(report.out, write=True) as kept:
        assert kept.begin_session("tuesday", {}) == 2


@pytest.mark.parametrize(("number", "size"), [(7, 9_000), (0, 300), (11, 120_000)])
def test_flipped_bytes_in_arrays(tmp_path, number, size):
    path = filled(tmp_path / "a.ebmap", 12, size)
    flip(path, arrays_of(number, size)["view"].tobytes()[:100], 20)
    with MapFile.open(path, write=False) as kept:
        with pytest.raises(Damaged, match=rf"a\.ebmap: the arrays of keyframe {number} are damaged; save .* --repair"):
            kept.arrays(number)
        for other in set(range(12)) - {number}:
            assert_arrays(kept.arrays(other), arrays_of(other, size))
        assert len(kept.keyframes()) == 12
    before = path.read_bytes()
    report = repair(path, tmp_path / "out.ebmap")
    assert report.lost[0] == f"1 of 12 keyframes: number {number}"
    assert report.summary().endswith("lost is what follows")
    assert path.read_bytes() == before
    with MapFile.open(report.out, write=False) as kept:
        assert kept.keyframes().id.tolist() == [other for other in range(12) if other != number]
        assert kept.facts == FACTS


def test_flipped_bytes_in_rows(tmp_path):
    for name, content, words, lost in (
        ("a", keyframe_of(4).pose.tobytes(), "row 4 of its table keyframes", ("1 of 12 keyframes: number 4",)),
        ("b", edge_of(9, 4, 0).covariance.tobytes(), "row 9 of its table edges", ("1 of 21 edges: number 9",)),
        ("c", b"monday.bag", "row 1 of its table sessions", ("name and facts of session 1; keyframes are kept",)),
        ("d", solved(11).tobytes(), "row 0 of its table settled", ("1 of 1 blocks of solved poses",)),
        ("e", b'{"words"', "row 1 of its table map", ("the map's facts",)),
    ):
        path = filled(tmp_path / f"{name}.ebmap")
        flip(path, content, 0)
        with MapFile.open(path, write=False) as kept, pytest.raises(Damaged, match=words):
            assert_filled(kept)
        report = repair(path, tmp_path / f"{name}-out.ebmap")
        assert report.lost and report.lost[0].startswith(lost), report.lost
        with MapFile.open(report.out, write=True) as kept:
            assert len(kept.keyframes()) >= 11 and len(kept.edges()) >= 18 and len(kept.frames()) >= 11
            assert kept.sessions() and isinstance(kept.facts, dict)
            kept.append(keyframe_of(50, kept.begin_session("tuesday", {})), arrays_of(50))


def test_a_lost_keyframe_takes_its_edges_and_frames_along(tmp_path):
    path = filled(tmp_path / "a.ebmap")
    flip(path, keyframe_of(4).pose.tobytes(), 0)
    report = repair(path, tmp_path / "out.ebmap")
    assert report.lost == (
        "1 of 12 keyframes: number 4",
        "1 of 12 frames between keyframes",
        "3 of 21 edges: numbers 8 to 10",
    )
    with MapFile.open(report.out, write=False) as kept:
        assert 4 not in kept.keyframes().id and 4 not in np.r_[kept.edges().i, kept.edges().j]
        with pytest.raises(ValueError, match="holds no keyframe 4"):
            kept.arrays(4)


def test_without_its_head_all_is_saved(tmp_path):
    for name, start, content in (("a", 0, bytes(100)), ("b", 0, os.urandom(PAGE)), ("c", 100, bytes(PAGE - 100))):
        path = filled(tmp_path / f"{name}.ebmap", 20, 9_000)
        changed(path, start, content)
        with pytest.raises(Damaged, match="--repair"):
            MapFile.open(path, write=False)
        report = repair(path, tmp_path / f"{name}-out.ebmap")
        assert not report.lost
        with MapFile.open(report.out, write=False) as kept:
            assert_filled(kept, 20, 9_000)


def subset_of(kept, count, size):
    """Whatever is there is what was written; returns how many keyframes and arrays are whole."""
    keyframes, edges = kept.keyframes(), kept.edges()
    poses, whole = np.vstack([solved(count - 1), keyframe_of(count - 1).pose]), 0
    for number, name, pose in zip(keyframes.id.tolist(), keyframes.name, keyframes.pose, strict=True):
        row = keyframe_of(number)
        assert name == row.name and pose.tobytes() in (row.pose.tobytes(), poses[number].tobytes())
        try:
            assert_arrays(kept.arrays(number), arrays_of(number, size))
            whole += 1
        except Damaged:
            pass
    for k, number in enumerate(edges.id.tolist()):
        assert edges.i_from_j[k].tobytes() == edge_of(number, 0, 0).i_from_j.tobytes()
    return len(keyframes), whole


@pytest.mark.parametrize("part", [0.2, 0.5, 0.9])
def test_what_is_left_of_a_truncated_file(tmp_path, part):
    path = filled(tmp_path / "a.ebmap", 60, 9_000)
    os.truncate(path, int(part * path.stat().st_size))
    report = repair(path, tmp_path / "out.ebmap")
    with MapFile.open(report.out, write=False) as kept:
        keyframes, whole = subset_of(kept, 60, 9_000)
    assert whole > 60 * part - 8 and keyframes >= whole and report.lost


@pytest.mark.parametrize("seed", range(4))
def test_no_damage_is_read_as_data_and_none_is_left_unsaid(tmp_path, seed):
    rng = np.random.default_rng(seed)
    whole = filled(tmp_path / "whole.ebmap", 8, 300)
    content = whole.read_bytes()
    for k in range(12):
        path, out = tmp_path / "a.ebmap", tmp_path / f"{k}.ebmap"
        damaged = bytearray(content)
        for _ in range(rng.integers(1, 4)):
            start, length = int(rng.integers(len(content))), int(rng.choice([1, 1, 8, 600, PAGE]))
            start = start // PAGE * PAGE if length == PAGE else start
            length = min(length, len(content) - start)
            damaged[start : start + length] = rng.bytes(length)
        path.write_bytes(damaged)
        try:
            with MapFile.open(path, write=False) as kept:
                assert_filled(kept, 8)
        except (Damaged, ValueError, OSError) as fault:
            assert str(path) in str(fault) and "\n" not in str(fault)
        try:
            report = repair(path, out)
        except ValueError as fault:
            assert "no row of a map" in str(fault)
            continue
        with MapFile.open(out, write=False) as kept:
            keyframes, arrays = subset_of(kept, 8, 300)
            if not report.lost:
                assert_filled(kept, 8)
            assert report.lost or (keyframes, arrays) == (8, 8)


@pytest.mark.parametrize(
    ("numbers", "words"),
    [([3], "edge 3"), ([5, 3, 4], "edges 3 to 5"), ([1, 9, 2], "edges 1 to 2, 9"), (range(0, 90, 2), "25 more runs")],
)
def test_numbers_in_words(numbers, words):
    assert words in named("edge", numbers)
