import os
import resource

import numpy as np
import pytest
import small_run
from small_run import CONFIG, assert_same, camera, driven, finished, opened, recording, result

from ebjax.geometry.planar import between
from ebjax.io.map_file.faults import Damaged
from ebjax.io.map_file.file import MapFile
from ebjax.io.map_file.lock import Locked
from ebjax.mapping.maintain import forget, repaired
from ebjax.mapping.store import temporary_map
from ebjax.slam.believe import KEPT
from ebjax.slam.finish import finish
from ebjax.slam.mapper import Mapper
from ebjax.slam.store import Store
from ebjax.slam.walker import default_view


@pytest.mark.slow
def test_gives_what_a_run_in_memory_gives(whole):
    assert_same(result(finish(driven(None), lambda *_: pytest.fail("driven again"))), whole.result)


def test_the_file_says_what_the_run_says(whole):
    run = whole.run
    with MapFile.open(whole.path, write=False) as file:
        (session,), keyframes, edges, frames = file.sessions(), file.keyframes(), file.edges(), file.frames()
    assert (session.name, session.finished, session.facts["first_stamp_s"]) == ("monday", True, 100.0)
    assert keyframes.frame.tolist() == run.keyframes.tolist() and len(keyframes) == len(whole.arrays)
    assert keyframes.pose.tobytes() == run.poses[run.keyframes].tobytes()
    assert sorted([*keyframes.frame, *frames.frame]) == list(range(len(recording())))
    assert keyframes.name == tuple(f"rgb/{frame:04d}.png" for frame in keyframes.frame)
    closures = np.array([kind == "closure" for kind in edges.kind])
    assert len(closures) - closures.sum() == len(keyframes) - 1
    said = dict(
        zip(zip(run.candidates.i, run.candidates.j, run.candidates.opposing, strict=True), run.reasons, strict=True)
    )
    for k in np.flatnonzero(closures):
        end = keyframes.frame[edges.i[k]], keyframes.frame[edges.j[k]], edges.opposing[k]
        assert said.pop(end) == edges.reason[k] and edges.kept[k] == (edges.reason[k] == KEPT)
        assert np.isfinite(edges.distance[k]) and edges.matches[k] >= edges.inliers[k]
    assert not said and edges.kept[closures].sum() >= 3
    # Steps lead from each keyframe to the one before, as they were when it came.
    came = np.array([kept["at.pose"] for kept in whole.arrays])
    np.testing.assert_allclose(between(came[1:], came[:-1]), edges.i_from_j[~closures], atol=1e-12)
    assert (np.linalg.eigvalsh(edges.covariance[~closures]) > 0).all()


def test_the_path_of_a_finished_session_is_read_back(whole, tmp_path):
    with opened(whole.path) as store:
        assert store.notes[0].startswith(f"{whole.path}: holds monday as session 1 already; it is added once more")
        path = store.path(1)
        assert store.poses(1).tobytes() == whole.run.poses.tobytes()
        with pytest.raises(ValueError, match="holds no finished session 2"):
            store.path(2)
        kept = store.arrays(5)
        pose, step = store.settled_step(5, kept)
        store.file.forget(store.current)
    for name in ("frames", "poses", "covariance", "row", "row_from_frame", "share"):
        assert getattr(path, name).tobytes() == getattr(whole.run.path, name).tobytes()
    for one, other in zip(path.edges, whole.run.path.edges, strict=True):
        np.testing.assert_array_equal(one, other)
    assert pose.tobytes() == path.poses[5].tobytes() and (4 * step == path.covariance[4]).all()


def test_rows_are_those_of_all_sessions_by_their_ids(whole, tmp_path):
    path = tmp_path / "a.ebmap"
    with opened(path) as store:
        assert isinstance(store, Store)
        whole.keep(store, range(8))
        store.file.end_session(1)
    with opened(path, log="tuesday") as store:
        whole.keep(store, range(8, 14))
        assert [store.piece(row) for row in range(len(store))] == [1] * 8 + [2] * 6 and store.current == 2
        for row in range(14):
            kept = store.arrays(row)
            assert kept.keys() == whole.arrays[row].keys()
            assert all(kept[name].tobytes() == values.tobytes() for name, values in whole.arrays[row].items())
    assert forget(path, 1)[0].startswith(f"{path}: forgot session 1, monday: 8 keyframes, ")
    with opened(path, log="tuesday") as store:
        assert len(store) == 6 and store.file.keyframes().id.tolist() == list(range(8, 14))
        for row in range(6):
            kept, was = store.arrays(row), whole.arrays[row + 8]
            assert kept["pairs.j"].tolist() == [j - 8 for j in was["pairs.j"] if j >= 8]
            assert kept["view"].tobytes() == was["view"].tobytes()
        edges = store.file.edges()
        assert edges.i.min() >= 8 and edges.j.min() >= 8
        assert store.file.edges("step").i.tolist() == list(range(9, 14))


def test_what_another_session_came_after_is_not_gone_on_with(whole, tmp_path):
    path = tmp_path / "a.ebmap"
    for log in ("monday", "tuesday"):
        with opened(path, log=log) as store:
            whole.keep(store, range(3))
    words = f"session 1 of monday was not finished, and session 2 came after it; .* --map {path} --forget 1"
    with pytest.raises(ValueError, match=words):
        opened(path)
    forget(path, 1)
    with opened(path) as store:
        assert len(store) == 3 and store.current == 3


@pytest.mark.slow
def test_goes_on_after_a_full_disk(whole, tmp_path):
    path, count = tmp_path / "a.ebmap", len(whole.arrays)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    store = opened(path)
    whole.keep(store, range(count - 6))
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.with_name("a.ebmap-wal").stat().st_size + 50_000, limits[1]))
    try:
        with pytest.raises(OSError, match="make room") as fault:
            driven(store)
        assert len(store) == count - 6 and str(fault.value.filename) == str(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    with pytest.raises(Locked, match="this process itself"):
        opened(path)
    store.close()
    with opened(path) as store:
        assert_same(result(finished(store)), whole.result)


def test_goes_on_after_a_repair(whole, tmp_path):
    path, count = tmp_path / "a.ebmap", len(whole.arrays)
    with opened(path) as store:
        whole.keep(store, range(count - 3))
    content = bytearray(path.read_bytes())
    at = content.index(whole.arrays[4]["features.descriptors"].tobytes()[500:600])
    content[at : at + 30] = os.urandom(30)
    path.write_bytes(content)
    with (
        opened(path) as store,
        pytest.raises(Damaged, match=f"^{path}: the arrays of keyframe 4 are damaged.*--repair"),
    ):
        driven(store)
    lines = repaired(path)
    out = tmp_path / "a.repaired.ebmap"
    assert (
        lines[0].startswith(f"{out}: saved 1 sessions, {count - 4} keyframes")
        and lines[-1] == f"go on with --map {out}"
    )
    assert f"lost: 1 of {count - 3} keyframes: number 4" in lines
    with opened(out) as store:
        found = finished(store)
        assert len(store) == count - 1
    assert sum(reason == KEPT for reason in found.reasons) >= whole.run.kept.sum() - 1
    np.testing.assert_allclose(found.poses, whole.run.poses, atol=0.02)


def test_a_run_that_is_driven_again_is_read_and_gone_on_with(whole, tmp_path):
    path, count = tmp_path / "a.ebmap", len(whole.arrays)
    tilted, more = camera(36.0), camera(36.2)
    with opened(path) as store:
        whole.keep(store, range(count))
        second = store.again(tilted, default_view(tilted))
        assert len(second) == 0 and second.current == 2
        whole.keep(second, range(7))
        # The first drive is what it was, and the second does not know it.
        assert len(store) == count and {store.piece(row) for row in range(count)} == {1}
        assert store.arrays(count - 1)["view"].tobytes() == whole.arrays[count - 1]["view"].tobytes()
        assert second.arrays(6)["pairs.j"].tolist() == whole.arrays[6]["pairs.j"].tolist()
    with opened(path) as store:
        assert store.current == 1 and len(store) == count
        second = store.again(tilted, default_view(tilted))
        assert second.current == 2 and len(second) == 7
        third = second.again(more, default_view(more))
        assert third.current == 3 and len(third) == 0
        whole.keep(second, range(7, count))
        second.finished(whole.run)
        assert [(one.id, one.finished) for one in store.file.sessions()] == [(2, True)]
    with opened(path, log="tuesday") as store:
        assert len(store) == count and {store.piece(row) for row in range(count)} == {2}


@pytest.mark.slow
def test_the_robot_is_followed_by_the_floor_and_gone_on_with(tmp_path):
    run = recording(24, wheels=False)
    with opened(tmp_path / "whole.ebmap") as store:
        expected, kept = driven(store, run), [store.arrays(row) for row in range(len(store))]
        names = store.file.keyframes().name
    with opened(tmp_path / "a.ebmap") as store:
        for row in range(len(kept) - 2):
            store.keep(kept[row], names[row])
        found = driven(store, run)
    assert found.chain.poses.tobytes() == expected.chain.poses.tobytes()
    assert found.way_everywhere().tobytes() == expected.way_everywhere().tobytes()


def test_a_temporary_map_is_removed(whole, tmp_path):
    run = {"log": "monday", "first_stamp_s": 100.0, "config": CONFIG, "folder": tmp_path}
    with temporary_map(camera=camera(), view=default_view(camera()), **run) as store:
        whole.keep(store, range(3))
        assert len(list(tmp_path.rglob("*.ebmap"))) == 1 and len(store) == 3
    assert not list(tmp_path.iterdir())


def test_an_engine_without_a_recording_goes_on_too(whole, tmp_path):
    from ebjax.slam.frame import Frame

    run, store = recording(), opened(tmp_path / "a.ebmap")
    whole.keep(store, range(10))
    engine = Mapper(camera(), CONFIG, view=default_view, store=store)
    for k in range(engine.next_frame + 8):
        rgb, _ = run.load(k)
        frame = Frame(float(run.timestamps[k]), rgb, None, run.odom_from_base[k], run.names[k])
        engine.pass_by(frame) if k < engine.next_frame and not len(store) > 10 else engine.add(frame)
    again = [store.arrays(row)["at.pose"].tobytes() for row in range(10, len(store))]
    assert again and again == [kept["at.pose"].tobytes() for kept in whole.arrays[10 : 10 + len(again)]]
    store.close()
    assert small_run.held(tmp_path / "a.ebmap") == 10 + len(again)
