"""Medians of floor views: against NumPy, on floors drawn under a mirror image, and on a rendered polished corridor."""

from pathlib import Path

import numpy as np
import pytest

import ebjax
from ebjax.config import load_config
from ebjax.floors.sequence import CorridorConfig
from ebjax.geometry.planar import between
from ebjax.slam.believe import BeliefConfig
from ebjax.slam.medians import GAIN, LEAST, MIDDLE, NEIGHBOURS, believing, median_view, neighbours
from ebjax.slam.mirrored import detail
from ebjax.worlds.render import render_sequence

RNG = np.random.default_rng(4)
SIZE = (60, 80)


@pytest.mark.parametrize("count", [1, 2, 5, 8])
def test_the_median_is_numpys(count):
    details = RNG.standard_normal((count, *SIZE)).astype(np.float32)
    floors = RNG.random((count, *SIZE)) < 0.7
    grey, floor = median_view(list(details), list(floors), [np.eye(3)] * count)
    np.testing.assert_array_equal(floor, floors.sum(0) >= min(LEAST, count))
    middle = np.ma.filled(np.ma.median(np.ma.masked_array(details, ~floors), axis=0), 0)
    np.testing.assert_array_equal(grey, np.where(floor, np.rint(MIDDLE + GAIN * middle).clip(0, 255), 0))


def test_what_moves_against_the_floor_is_left_out():
    """The robot drives up the picture by 8 px a view; a bright streak stays where it is in every view."""
    floor, step = np.ones(SIZE, bool), 8
    world = 20 * RNG.standard_normal((SIZE[0] + 8 * step, SIZE[1])) + 100
    views, warps = [], []
    for k in range(9):
        view = world[k * step : k * step + SIZE[0]].copy()
        view[20:26, 10:70] = 250
        views.append(np.repeat(view.clip(0, 255).astype(np.uint8)[..., None], 3, 2))
        warps.append(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, step * (k - 4.0)], [0.0, 0.0, 1.0]]))
    clean = detail(np.repeat(world[4 * step :][: SIZE[0]].astype(np.uint8)[..., None], 3, 2), floor)
    grey, seen = median_view([detail(view, floor) for view in views], [floor] * 9, warps)
    assert seen[20:40].all()

    def alike(picture):
        return np.corrcoef(picture[20:26, 10:70].ravel(), clean[20:26, 10:70].ravel())[0, 1]

    assert alike(detail(views[4], floor)) < 0.2 and alike(grey.astype(float)) > 0.8


def test_two_medians_that_are_compared_have_no_view_in_common():
    travelled = np.cumsum(RNG.uniform(0, 0.4, 60))
    for k in range(60):
        near = neighbours(k, travelled, 1.6)
        assert k in near and len(near) <= 2 * NEIGHBOURS + 1
        assert np.abs(travelled[list(near)] - travelled[k]).max() <= 1.6
        far = np.flatnonzero(np.abs(travelled - travelled[k]) >= 4.0)
        assert not any(set(near) & set(neighbours(int(j), travelled, 1.6)) for j in far)


def test_keyframes_on_the_spot_are_their_own_neighbours():
    assert list(neighbours(2, np.zeros(5), 1.6)) == [0, 1, 2, 3, 4]


def test_a_closure_stands_out_from_the_other_candidates():
    usual = BeliefConfig()
    assert believing(usual, np.zeros(0, int)).min_inliers == 12
    assert believing(usual, np.array([5, 5, 6, 30])).min_inliers == 12
    # On a floor that repeats most candidates have many.
    found = believing(usual, np.array([41, 40, 43, 90]))
    assert found.min_inliers == 84 and found.min_inlier_ratio == 0 and found.min_agreeing == 4
    assert (found.max_sigma_m, found.odometry_sigmas) == (usual.max_sigma_m, usual.odometry_sigmas)


@pytest.mark.whole
def test_a_polished_corridor_is_closed_on_its_medians(tmp_path):
    """20 m of near-white porcelain there and back, which mirrors windows and strips of lamps: no view shows a place."""
    config = load_config(Path(__file__).parents[2] / "configs" / "worlds" / "G1.yaml", CorridorConfig)
    render_sequence(config, tmp_path / "G1")
    log = ebjax.open_log(tmp_path / "G1")
    run = ebjax.close_loops(log)
    assert "the floor mirrors the room" in run.mirrored and "medians" in run.mirrored
    kept, candidates, truth = run.kept, run.candidates, log.truth[run.keyframes]
    i, j = (np.searchsorted(run.keyframes, ends[kept]) for ends in (candidates.i, candidates.j))
    off = between(between(truth[i], truth[j]), candidates.i_from_j[kept])
    assert kept.sum() >= 15 and candidates.opposing[kept].all()
    assert np.linalg.norm(off[:, :2], axis=1).max() < 0.1 and np.degrees(np.abs(off[:, 2])).max() < 3
