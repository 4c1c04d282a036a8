import types
from unittest.mock import Mock

import numpy as np
import pytest

from ebjax.geometry.camera import FloorView, camera_over_floor
from ebjax.geometry.homography import apply
from ebjax.slam.run import Run
from ebjax.train.finetune import Config, comb, run, taught
from ebjax.views.run_view import from_camera

CAMERA = camera_over_floor(120.0, 120.0, 79.5, 59.5, 160, 120, 0.6, 0.5)
VIEW = from_camera(CAMERA, FloorView(0.6, 1.4, -0.4, 0.4, 0.02))


def result(closures):
    """Two frames out, two back over the same floor, and what slam would say of them."""
    poses = np.array([[0.0, 0, 0], [1.0, 0, 0], [3.0, 0, np.pi], [2.0, 0, np.pi]])
    kept = np.ones(closures, bool)
    candidates = types.SimpleNamespace(i=np.resize([2, 3], closures))
    view = np.random.default_rng(0).integers(0, 255, (4, *VIEW.size, 3), np.uint8)
    made = Mock(spec=Run)
    made.kept, made.keyframes, made.candidates = kept, np.arange(4), candidates
    made.poses, made.seen = poses, lambda k: view[k]
    return made


def test_pairs_lie_on_each_other_as_the_poses_say():
    lesson = taught(result(6), VIEW, 0.1)
    # The way out looks at x = 1 and 2 m, the way back at 2 and 1 m.
    assert list(zip(lesson.later, lesson.earlier, strict=True)) == [(2, 1), (3, 0)]
    np.testing.assert_allclose(lesson.along_m, [1, 0], atol=1e-12)
    pixels = np.array([[5.0, 7.0], [30.0, 12.0]])
    for warp in lesson.turned_from_later:
        # Facing views with one centre, turned by pi, are the same view.
        np.testing.assert_allclose(np.asarray(apply(warp, pixels)), pixels, atol=1e-9)


def test_too_few_closures_teach_nothing():
    with pytest.raises(ValueError, match="slam accepts 2 closures on this run; to learn from it takes 6"):
        taught(result(2), VIEW, 0.1)


def test_a_comb_spreads_its_places():
    along = np.linspace(0, 12, 200)
    rows = comb(along, 6, np.random.default_rng(1))
    assert (np.diff(np.sort(along[rows])) > 0.9).all() and len(rows) == 6
    assert (rows != comb(along, 6, np.random.default_rng(2))).any()


def test_a_run_must_be_named(tmp_path):
    with pytest.raises(ValueError, match="sequence is not set"):
        run(Config(), tmp_path, resume=False)
