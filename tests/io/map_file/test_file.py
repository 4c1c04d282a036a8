"""A map gives back what was written, says no to what contradicts it, and keeps pace with any order of calls."""

import gzip
import importlib
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ebjax.io.map_file.file import MapFile
from ebjax.io.map_file.reader import OF_MAP

sys.path.insert(0, str(Path(__file__).parent))
made = importlib.import_module("small_maps")
FACTS, GOLDEN, append, arrays_of, assert_arrays, assert_filled, edge_of, filled, frame_of, keyframe_of, solved = (
    getattr(made, name)
    for name in (
        *"FACTS GOLDEN append arrays_of assert_arrays assert_filled".split(),
        *"edge_of filled frame_of keyframe_of solved".split(),
    )
)


@pytest.mark.parametrize(("count", "size"), [(12, 300), (5, 0), (4, 120_000)])
def test_everything_comes_back(tmp_path, count, size):
    path = filled(tmp_path / "deep" / "er" / "a map.ebmap", count, size)
    assert os.listdir(path.parent) == [path.name], "nothing is left beside it"
    with MapFile.open(path, write=False) as kept:
        assert not kept.notes and not kept.writes
        assert_filled(kept, count, size)
    with MapFile.open(path, write=True) as kept:
        assert_filled(kept, count, size)


def test_a_map_of_version_1_still_opens(tmp_path):
    path = tmp_path / "golden.ebmap"
    path.write_bytes(gzip.decompress(GOLDEN.read_bytes()))
    with MapFile.open(path, write=False) as kept:
        assert_filled(kept)
    with MapFile.open(path, write=True) as kept:
        append(kept, 12, kept.begin_session("tuesday", {}))
        assert len(kept.keyframes()) == 13


def test_a_keyframe_costs_little_more_than_its_arrays(tmp_path):
    path = filled(tmp_path / "a.ebmap", 60, 115_000)
    assert path.stat().st_size < 60 * 120_000


def test_sessions_and_their_parts(tmp_path):
    with MapFile.create(tmp_path / "a.ebmap", FACTS) as kept:
        first = kept.begin_session("monday", {})
        append(kept, 0, first)
        append(kept, 1, first)
        kept.end_session(first)
        second = kept.begin_session("tuesday", {"lens": [1, 2.5, None]})
        append(kept, 2, second)
        assert [(row.id, row.finished) for row in kept.sessions()] == [(1, True), (2, False)]
        assert kept.keyframes(second).id.tolist() == [2] and kept.keyframes(first).id.tolist() == [0, 1]
        assert kept.frames(second).frame.tolist() == [5] and len(kept.frames()) == 3
        assert kept.edges("step").id.tolist() == [2, 4] and kept.edges("closure").id.tolist() == [5]
        kept.add([(edge_of(99, 2, 1), {"k": np.arange(3)})], [frame_of(50, 2)])
        assert kept.edges().id.tolist() == [2, 4, 5, 99] and kept.frames(second).frame.tolist() == [5, 50]
        kept.settle(edges=[2, 99], kept=[False, True], reasons=["", "it agrees"])
        assert kept.edges().kept.tolist() == [False, False, True, True] and kept.edges().reason[3] == "it agrees"
        assert kept.keyframes().pose.tobytes() == np.array([keyframe_of(k).pose for k in range(3)]).tobytes()
        kept.put_state(OF_MAP, "grid", {"a": np.ones(3)})
        kept.put_state(OF_MAP, "grid", {"b": np.zeros(2)})
        kept.put_state(second, "grid", {"c": np.zeros(1)})
        assert_arrays(kept.state(OF_MAP, "grid"), {"b": np.zeros(2)})
        assert_arrays(kept.state(second, "grid"), {"c": np.zeros(1)})
        assert kept.state(first, "grid") == {}


def test_what_contradicts_the_map_is_refused_and_changes_nothing(tmp_path):
    path = tmp_path / "a.ebmap"
    with MapFile.create(path, FACTS) as kept:
        session = kept.begin_session("monday", {})
        append(kept, 0, session)
        done = kept.begin_session("done", {})
        kept.end_session(done)
        cases = [
            (keyframe_of(0), [], [], "row 0 of keyframes is there already; give each id once"),
            (keyframe_of(1, 7), [], [], "holds no session 7; it has 1, 2"),
            (keyframe_of(1, done), [], [], "session 2 is finished; begin another"),
            (keyframe_of(1), [(edge_of(1, 1, 5), {})], [], "holds no keyframe 5; append it before what refers to it"),
            (keyframe_of(1), [(edge_of(1, 1, 0), {})] * 2, [], "row 1 of edges is there already"),
            (keyframe_of(1), [], [frame_of(1, 9)], "holds no keyframe 9"),
            (replace(keyframe_of(1), pose=np.array([0, np.nan, 0])), [], [], "keyframe 1: its pose .* is not finite"),
            (replace(keyframe_of(1), name="rgb/\udcff.png"), [], [], r"the name 'rgb/\\udcff.png' is not text"),
            (replace(keyframe_of(1), frame=2**70), [], [], "a number of more than 64 bits"),
        ]
        for keyframe, edges, frames, words in cases:
            with pytest.raises(ValueError, match=words):
                kept.append(keyframe, arrays_of(1), edges, frames)
        with pytest.raises(ValueError, match="array 'a' is of type object"):
            kept.append(keyframe_of(1), {"a": np.array([None])})
        with pytest.raises(ValueError, match="holds no edge 8"):
            kept.settle([0], solved(1), edges=[8], kept=[True], reasons=[""])
        with pytest.raises(ValueError, match="holds no keyframe 3"):
            kept.settle([0, 3], solved(2))
        for poses in (solved(2), np.full((1, 3), np.nan)):
            with pytest.raises(ValueError, match="1 keyframes need as many finite poses"):
                kept.settle([0], poses)
        with pytest.raises(ValueError, match="holds no session 9; it has 1, 2"):
            kept.forget(9)
        with pytest.raises(ValueError, match="facts of a map must be plain values"):
            kept.begin_session("x", {"a": np.zeros(1)})
        for call in (kept.arrays, kept.edge_arrays):
            with pytest.raises(ValueError, match=r"holds no (keyframe|edge) 44"):
                call(44)
        assert kept.keyframes().pose.tolist() == [[0, 0, 0]] and len(kept.edges()) == 0 and len(kept.sessions()) == 2
        kept.append(keyframe_of(1), arrays_of(1))
    with pytest.raises(ValueError, match="closed"):
        kept.keyframes()
    kept.close()
    with MapFile.open(path, write=False) as kept, pytest.raises(ValueError, match=r"open for reading; .* write=True"):
        kept.begin_session("x", {})
    with MapFile.open(path, write=True) as kept:
        with kept.snapshot(), pytest.raises(ValueError, match="nothing is written inside a snapshot; leave it first"):
            kept.begin_session("x", {})
        kept.begin_session("x", {})
    with pytest.raises(FileExistsError, match="is there already; name another file, or remove it"):
        MapFile.create(path, {})
    assert os.listdir(tmp_path) == ["a.ebmap"]


def test_dropping_and_changing_arrays(tmp_path):
    path = filled(tmp_path / "a.ebmap", 30, 50_000)
    before = path.stat().st_size
    with MapFile.open(path, write=True) as kept:

        def without(number, arrays):
            return {name: array for name, array in arrays.items() if name != "view"} if "view" in arrays else None

        assert kept.change_arrays(without) == 30 and kept.change_arrays(without) == 0 and not kept.notes
        expected = {name: array for name, array in arrays_of(4, 50_000).items() if name != "view"}
        assert_arrays(kept.arrays(4), expected)

        def halved(number, arrays):
            return {**arrays, "points": arrays["points"] / 2} if number % 2 else None

        assert kept.change_arrays(halved) == 15
        assert_arrays(kept.arrays(4), expected)
        np.testing.assert_array_equal(kept.arrays(5)["points"], arrays_of(5, 50_000)["points"] / 2)
        with pytest.raises(ZeroDivisionError):
            kept.change_arrays(lambda number, arrays: {"a": np.array(1 // (number - 3))})
        assert_arrays(kept.arrays(4), expected)
    assert path.stat().st_size < before / 8


class Model:
    """What a map should hold, in dictionaries."""

    def __init__(self):
        self.sessions, self.keyframes, self.edges, self.frames = {}, {}, {}, []

    def forget(self, session):
        del self.sessions[session]
        gone = {k for k, (of, _) in self.keyframes.items() if of == session}
        self.keyframes = {k: row for k, row in self.keyframes.items() if k not in gone}
        self.edges = {k: row for k, row in self.edges.items() if not {row[0], row[1]} & gone}
        self.frames = [(frame, keyframe) for frame, keyframe in self.frames if keyframe not in gone]

    def check(self, kept):
        keyframes, edges, frames = kept.keyframes(), kept.edges(), kept.frames()
        assert [row.id for row in kept.sessions()] == sorted(self.sessions)
        assert keyframes.id.tolist() == sorted(self.keyframes)
        for number, session, pose in zip(keyframes.id.tolist(), keyframes.session, keyframes.pose, strict=True):
            assert (session, pose.tobytes()) == (self.keyframes[number][0], self.keyframes[number][1].tobytes())
        assert edges.id.tolist() == sorted(self.edges)
        for k, number in enumerate(edges.id.tolist()):
            assert (edges.i[k], edges.j[k], edges.kept[k], edges.reason[k]) == self.edges[number]
        assert list(zip(frames.frame.tolist(), frames.keyframe.tolist(), strict=True)) == self.frames
        for number in list(self.keyframes)[::5]:
            assert_arrays(kept.arrays(number), arrays_of(number, 50))


@pytest.mark.parametrize("seed", range(5))
def test_any_sequence_of_calls_equals_a_model(tmp_path, seed):
    rng, path, model = np.random.default_rng(seed), tmp_path / "a.ebmap", Model()
    kept = MapFile.create(path, FACTS)
    for step in range(80):
        act = rng.choice(["append", "append", "append", "session", "settle", "forget", "reopen", "read"])
        if act == "session" or not model.sessions:
            model.sessions[kept.begin_session(f"session {step}", {})] = True
        elif act == "append":
            # Numbers far apart, so that solved poses lie in several blocks; some are given anew after forgetting.
            number = int(rng.integers(0, 1000))
            if number in model.keyframes:
                continue
            session, others = int(rng.choice(list(model.sessions))), list(model.keyframes)
            partners = [] if not others else rng.choice(others, min(3, len(others)), replace=False).tolist()
            edges = [(edge_of(3000 * step + k, number, j), {"x": np.arange(k)}) for k, j in enumerate(partners)]
            kept.append(keyframe_of(number, session), arrays_of(number, 50), edges, [frame_of(step, number)])
            model.keyframes[number] = (session, keyframe_of(number).pose)
            model.edges |= {row.id: (row.i, row.j, row.kept, row.reason) for row, _ in edges}
            model.frames.append((step, number))
        elif act == "settle" and model.keyframes:
            ids = rng.choice(list(model.keyframes), rng.integers(1, len(model.keyframes) + 1), replace=False)
            poses = rng.standard_normal((len(ids), 3))
            edges = list(model.edges)[::3]
            kept.settle(ids, poses, edges=edges, kept=[step % 2 == 0] * len(edges), reasons=[str(step)] * len(edges))
            for number, pose in zip(ids.tolist(), poses, strict=True):
                model.keyframes[number] = (model.keyframes[number][0], pose)
            for number in edges:
                model.edges[number] = (*model.edges[number][:2], step % 2 == 0, str(step))
        elif act == "forget" and rng.random() < 0.3:
            session = int(rng.choice(list(model.sessions)))
            kept.forget(session)
            model.forget(session)
        elif act == "reopen":
            kept.close()
            kept = MapFile.open(path, write=True)
        elif act == "read":
            with MapFile.open(path, write=False) as reader:
                model.check(reader)
    model.check(kept)
    kept.close()
    with MapFile.open(path, write=False) as kept:
        model.check(kept)
