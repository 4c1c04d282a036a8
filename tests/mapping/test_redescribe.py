"""A map described anew: with what it was described with, and with something else; stopped, and gone on with."""

import dataclasses
import os
import re
import shutil

import numpy as np
import pytest
from small_run import CONFIG, camera, driven, finished, opened, recording

from ebjax.geometry.planar import between
from ebjax.io.map_file.file import MapFile
from ebjax.io.map_file.lock import Locked
from ebjax.mapping.export import export_map
from ebjax.mapping.localised_run import localise_run
from ebjax.mapping.maintain import drop_views
from ebjax.mapping.redescribe import redescribe
from ebjax.mapping.shelf import MapShelf
from ebjax.slam.config import PipelineConfig
from ebjax.slam.walker import default_view

OTHER = dataclasses.replace(CONFIG, extractor="sift", descriptor="hog")


@pytest.fixture
def building(whole, tmp_path):
    return shutil.copy(whole.path, tmp_path / "building.ebmap")


@pytest.fixture(scope="module")
def described(whole, tmp_path_factory):
    """The map described anew with the same weights, whatever else the command says; and what was said."""
    path = shutil.copy(whole.path, tmp_path_factory.mktemp("anew") / "building.ebmap")
    lines = redescribe(path, PipelineConfig())
    assert path.read_bytes() == whole.path.read_bytes()
    assert sorted(os.listdir(path.parent)) == ["building.ebmap", "building.redescribed.ebmap"]
    return path.with_name("building.redescribed.ebmap"), lines


def contents(path):
    with MapFile.open(path, write=False) as file:
        keyframes = file.keyframes()
        arrays = {number: file.arrays(number) for number in keyframes.id.tolist()}
        return file.facts, file.sessions(), keyframes, file.frames(), file.edges(), arrays


def columns(rows):
    return [np.asarray(getattr(rows, field.name)) for field in dataclasses.fields(rows)]


def test_with_the_same_weights_it_is_what_it_was_but_for_jpeg(whole, described):
    path, lines = described
    facts, (was,), keyframes, frames, edges, arrays = contents(whole.path)
    new_facts, (now,), new_keyframes, new_frames, new_edges, new = contents(path)
    assert new_facts == facts and dataclasses.replace(now, state=()) == dataclasses.replace(was, state=())
    assert set(now.state) == set(was.state)
    for one, other in zip(columns(frames), columns(new_frames), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_allclose(between(keyframes.pose, new_keyframes.pose), 0, atol=0.005)
    for name in ("id", "session", "frame", "stamp_s", "name"):
        np.testing.assert_array_equal(getattr(new_keyframes, name), getattr(keyframes, name))
    steps, new_steps = (np.array([kind == "step" for kind in one.kind]) for one in (edges, new_edges))
    for one, other in zip(columns(edges), columns(new_edges), strict=True):
        np.testing.assert_array_equal(one[steps], other[new_steps])
    assert abs(int(new_edges.kept[~new_steps].sum()) - int(edges.kept[~steps].sum())) <= 1
    assert "not thought over yet" not in new_edges.reason
    for number, kept in arrays.items():
        assert new[number].keys() == kept.keys()
        for name, values in kept.items():
            if name in ("view", "grey", "floor") or name.startswith(("at.", "steps.")):
                assert new[number][name].tobytes() == values.tobytes()
        vectors = [one["place.vector"].astype(float) for one in (kept, new[number])]
        assert vectors[0] @ vectors[1] / np.prod(np.linalg.norm(vectors, axis=1)) > 0.95
    assert f"described {len(keyframes)} keyframes of 1 session anew; it kept" in lines[0]
    assert "what changed is what JPEG changed" in lines[1] and lines[-1] == f"go on with --map {path}"


@pytest.mark.slow
def test_a_run_that_is_described_otherwise_is_refused_and_the_remedy_works(whole, building, tmp_path):
    words = f"^{building}: was made with extractor floornet, this run has sift; .*--map {building} --redescribe"
    with pytest.raises(ValueError, match=words):
        opened(building, config=OTHER, log="tuesday")
    lines = redescribe(building, OTHER)
    path = tmp_path / "building.redescribed.ebmap"
    assert lines[-1] == f"go on with --map {path}" and not any("JPEG" in line for line in lines)
    said = localise_run(path, recording(20), camera(), default_view(camera()), OTHER, tmp_path / "where")
    assert any(line.startswith("found at frame") for line in said)
    with MapFile.open(path, write=False) as file:
        assert "loop_closures.csv" in export_map(file, tmp_path / "out", 0.02).files
        assert file.edges("closure").kept.sum() >= 2
    with opened(path, config=OTHER, log="tuesday") as store:
        engine = driven(store, recording(20), OTHER)
        assert engine.start == len(whole.arrays)
        assert (engine.belief.kept & (engine.candidates.i >= engine.start)).sum() >= 3
    with pytest.raises(ValueError, match="was made with extractor sift, this run has floornet"):
        opened(path, log="wednesday")


def test_other_words_are_refused_by_the_same_remedy(building):
    with MapFile.open(building, write=False) as file:
        facts = file.facts | {"words of places": "1-older"}
    older = building.with_name("older.ebmap")
    MapFile.create(older, facts).close()
    with pytest.raises(ValueError, match=f"words of places 1-older, .*--map {older} --redescribe"):
        opened(older)


def test_keypoints_of_an_older_ebjax_are_refused_by_the_same_remedy(building):
    """Its maps do not say which version of the extractor they were made with."""
    with MapFile.open(building, write=False) as file:
        facts = {name: value for name, value in file.facts.items() if name != "version of the extractor"}
    older = building.with_name("corners.ebmap")
    MapFile.create(older, facts).close()
    with pytest.raises(ValueError, match=f"version of the extractor 1, this run has 2; .*--map {older} --redescribe"):
        opened(older)
    assert redescribe(older, CONFIG) != redescribe(building, CONFIG)


@pytest.mark.slow
def test_an_unfinished_session_is_gone_on_with(whole, tmp_path):
    path, count = tmp_path / "building.ebmap", len(whole.arrays)
    with opened(path) as store:
        whole.keep(store, range(count - 5))
    redescribe(path, PipelineConfig())
    with opened(tmp_path / "building.redescribed.ebmap") as store:
        assert store.notes == (f"{store.file.path}: goes on with session 1 of monday after {count - 5} keyframes",)
        run = finished(store)
    off = run.poses - whole.run.poses
    off[:, 2] = (off[:, 2] + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(off, 0, atol=0.02)
    assert run.kept.sum() >= whole.run.kept.sum() - 1


@pytest.mark.slow
def test_a_run_without_wheels_is_gone_on_with_too(tmp_path):
    run = recording(24, wheels=False)
    with opened(tmp_path / "building.ebmap") as store:
        expected = driven(store, recording(20, wheels=False)).chain.poses
    redescribe(tmp_path / "building.ebmap", OTHER)
    with opened(tmp_path / "building.redescribed.ebmap", config=OTHER) as store:
        engine = driven(store, run, OTHER)
    assert len(engine.chain) > len(expected)
    np.testing.assert_array_equal(engine.chain.poses[: len(expected)], expected)


@pytest.mark.slow
@pytest.mark.parametrize("moment", ["first", "middle", "closures", "end"])
def test_stopped_at_any_moment_it_is_gone_on_with(whole, building, described, monkeypatch, moment):
    before, count, added = building.read_bytes(), len(whole.arrays), MapShelf.add
    most = {"first": 0, "middle": count // 2}.get(moment, count)

    def stops(shelf, *given):
        if len(shelf) == most:
            raise KeyboardInterrupt
        added(shelf, *given)

    def stop(*given, **options):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(MapShelf, "add", stops)
        if moment == "closures":
            patched.setattr(MapShelf, "conclude", stop)
        if moment == "end":
            patched.setattr("ebjax.mapping.redescribe._told", stop)
        redescribe(building, CONFIG)
    assert building.read_bytes() == before
    assert sorted(os.listdir(building.parent)) == ["building.ebmap", "building.redescribed.partial"]
    if moment == "middle":
        with pytest.raises(
            ValueError, match=r"partial: was begun from another state .* or with other flags; remove it"
        ):
            redescribe(building, OTHER)
    lines = redescribe(building, CONFIG)
    assert any(f"was gone on with after {most} keyframes" in line for line in lines) == bool(most)
    assert sorted(os.listdir(building.parent)) == ["building.ebmap", "building.redescribed.ebmap"]
    found, expected = contents(building.with_name("building.redescribed.ebmap")), contents(described[0])
    assert found[:2] == expected[:2]
    for one, other in zip(found[2:5], expected[2:5], strict=True):
        for a, b in zip(columns(one), columns(other), strict=True):
            np.testing.assert_array_equal(a, b)
    for number, kept in expected[5].items():
        assert all(found[5][number][name].tobytes() == values.tobytes() for name, values in kept.items())


def test_a_damaged_keyframe_is_named_and_the_rest_goes_on(whole, building):
    content = bytearray(building.read_bytes())
    at = content.index(whole.arrays[4]["features.descriptors"].tobytes()[500:600])
    content[at : at + 30] = os.urandom(30)
    building.write_bytes(content)
    lines = redescribe(building, CONFIG)
    assert "lost: keyframe 4, whose arrays are damaged" in lines
    _, _, keyframes, frames, edges, _ = contents(building.with_name("building.redescribed.ebmap"))
    assert keyframes.id.tolist() == [k for k in range(len(whole.arrays)) if k != 4]
    assert 4 not in frames.keyframe and 4 not in edges.i and 4 not in edges.j
    assert [edges.j[k] for k in np.flatnonzero(edges.i == 5) if edges.kind[k] == "step"] == [3]
    assert edges.kept[[kind == "closure" for kind in edges.kind]].sum() >= whole.run.kept.sum() - 1


@pytest.mark.slow
def test_several_sessions_keep_their_numbers_and_the_closures_between_them(whole, building):
    with opened(building, log="sunday") as store:
        whole.keep(store, range(2))
        store.file.forget(store.current)
    with opened(building, log="tuesday") as store:
        run, gone = finished(store), store.current - 1
    redescribe(building, CONFIG)
    was, now = contents(building), contents(building.with_name("building.redescribed.ebmap"))
    assert [one.id for one in now[1]] == [one.id for one in was[1]] == [1, gone + 1]
    np.testing.assert_allclose(between(was[2].pose, now[2].pose), 0, atol=0.005)
    session = dict(zip(now[2].id.tolist(), now[2].session.tolist(), strict=True))
    across = [session[i] != session[j] for i, j in zip(now[4].i.tolist(), now[4].j.tolist(), strict=True)]
    assert (now[4].kept & across).sum() >= run.earlier.closures - 2 > 0


def test_what_cannot_be_described_anew_is_refused(building, tmp_path):
    with pytest.raises(ValueError, match=r"--descriptor joint looks at the whole image, .*; give another --descriptor"):
        redescribe(building, dataclasses.replace(CONFIG, descriptor="joint"))
    with MapFile.open(building, write=True), pytest.raises(Locked, match="writes to it"):
        redescribe(building, CONFIG)
    out = tmp_path / "building.redescribed.ebmap"
    out.write_bytes(b"mine")
    with pytest.raises(FileExistsError, match=f"is there already; remove it, or give it another name: '{out}'"):
        redescribe(building, CONFIG)
    out.unlink()
    drop_views(building)
    words = f"the floor views of session 1 were dropped (--no-views), and nothing else .* --map {building} --forget 1"
    with pytest.raises(ValueError, match=re.escape(words).replace(r"\ \.\*\ ", " .* ")):
        redescribe(building, CONFIG)
    assert os.listdir(tmp_path) == ["building.ebmap"]
