"""A map's file that a run is localised in: what of it is looked for, and that no byte of it changes."""

import hashlib
import shutil

import numpy as np
import pytest
import small_run

from ebjax.geometry.planar import between, compose
from ebjax.mapping.contents import read_contents
from ebjax.mapping.still_map import joined_to_first, open_still_map
from ebjax.slam.frame import Frame
from ebjax.slam.localise import Localiser


def digest(path):
    return hashlib.sha256(path.read_bytes()).hexdigest(), sorted(one.name for one in path.parent.iterdir())


def localised(still, rows, start=None):
    there = Localiser(still.camera, small_run.CONFIG, still, still.poses, view=still.view, start=start)
    run = small_run.recording()
    return [
        there.add(Frame(float(run.timestamps[k]), run.load(k)[0], None, run.odom_from_base[k], run.names[k]))
        for k in rows
    ]


@pytest.mark.slow
def test_a_run_is_found_in_a_file_that_stays_as_it_is(whole):
    before = digest(whole.path)
    with open_still_map(whole.path) as still:
        np.testing.assert_allclose(still.poses, whole.run.poses[whole.run.keyframes])
        rows = range(10, len(small_run.truth()))
        said = localised(still, rows)
        assert still.notes == () and len(still) == len(whole.arrays)
    assert digest(whole.path) == before
    assert said[-1].state == "found" and said[-1].nearest is not None
    off = np.abs(between(said[-1].map_from_base, whole.run.poses[rows[-1]]))
    assert off[:2].max() < 0.03 and off[2] < 0.02


def test_a_start_is_found_in_it_at_once(whole):
    with open_still_map(whole.path) as still:
        start = compose(still.poses[0], np.array([0.05, 0.0, 0.02]))
        said = localised(still, range(4), tuple(start.tolist()))
    assert {one.state for one in said} == {"found"}


def test_the_camera_and_the_view_are_those_it_was_looked_at_with(whole):
    with open_still_map(whole.path) as still:
        camera, view = small_run.camera(), small_run.default_view(small_run.camera())
        np.testing.assert_allclose(still.camera.base_from_camera, camera.base_from_camera)
        np.testing.assert_allclose(still.view.image_from_view, view.image_from_view, rtol=1e-4, atol=1e-6)
        np.testing.assert_array_equal(still.view.seen, view.seen)


def test_sessions_that_say_nothing_are_left_out_and_named(whole, tmp_path):
    path = shutil.copy(whole.path, tmp_path / "two.ebmap")
    with small_run.opened(path, log="tuesday") as store:
        small_run.driven(store, small_run.recording(8))
        second = store.current
    with open_still_map(path) as still:
        assert set(still._pieces) == {1}
        count = len(still.file.keyframes(second))
        assert still.notes == (f"{path}: session {second} is not finished; its {count} keyframes are not looked for",)
        contents = read_contents(still.file)
        assert joined_to_first(contents, [1]) == [1]


def test_what_holds_nothing_to_find_is_refused(whole, tmp_path):
    path = tmp_path / "begun.ebmap"
    with pytest.raises(ValueError, match=r"begun.ebmap: there is no such map; a run begins it"):
        open_still_map(path)
    with small_run.opened(path) as store:
        small_run.driven(store, small_run.recording(4))
    with pytest.raises(ValueError, match=r"begun.ebmap: holds no finished run to be localised in; finish one first"):
        open_still_map(path)
    with small_run.opened(path) as store:  # the remedy
        whole.keep(store, range(len(store), len(whole.arrays)))
        small_run.finished(store)
    with open_still_map(path) as still, pytest.raises(ValueError, match="stands still while a run is localised in it"):
        still.keep({})
