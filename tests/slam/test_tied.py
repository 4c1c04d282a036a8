"""A stretch of path in a map that stands still: which closures are believed, and where they put it."""

import dataclasses

import numpy as np
import pytest

from ebjax.geometry.planar import between, chained, compose, inverse
from ebjax.slam.believe import KEPT, BeliefConfig
from ebjax.slam.measured import Measured
from ebjax.slam.tied import Settled, Stretch, believed, fits, measured_well, moved_on, seen_in_map, tied

COUNT, STEP_M = 24, 0.2
NOISE = np.array([0.004, 0.004, 0.003])
STEP_NOISE = np.array([0.002, 0.002, 0.002])


def world(seed):
    """A map along a line, and a stretch that drives back over it: both as they are, the stretch by noisy steps."""
    rng = np.random.default_rng(seed)
    there = np.stack([STEP_M * np.arange(60), np.zeros(60), np.zeros(60)], 1)
    back = np.stack([8.0 - STEP_M * np.arange(COUNT), np.full(COUNT, 0.1), np.full(COUNT, np.pi)], 1)
    steps = between(back[:-1], back[1:]) + rng.normal(0, STEP_NOISE, (COUNT - 1, 3))
    covariance = np.tile(np.diag(STEP_NOISE**2), (COUNT - 1, 1, 1))
    stretch = Stretch(chained(steps), covariance, STEP_M * np.arange(COUNT))
    return rng, Settled(there, STEP_M, np.diag(STEP_NOISE**2)), back, stretch


def closures(rng, settled, truth, rows, off=None):
    """Of some rows of the stretch with the map's nearest keyframes; `off` moves where one says that it is."""
    j = np.argmin(np.abs(settled.poses[:, 0] - truth[rows, 0, None]), 1)
    measured = between(truth[rows], settled.poses[j])
    measured = compose(measured, rng.normal(0, NOISE, measured.shape))
    if off is not None:
        measured = compose(np.broadcast_to(inverse(off), measured.shape), measured)
    count = len(rows)
    numbers = np.full(count, 90), np.full(count, 100)
    covariance = np.tile(np.diag(NOISE**2), (count, 1, 1))
    return Measured(np.array(rows), j, np.ones(count, bool), np.full(count, 0.2), *numbers, measured, covariance)


def both(one, other):
    return Measured(*(np.concatenate([a, b]) for a, b in zip(*map(dataclasses.astuple, (one, other)), strict=True)))


@pytest.mark.parametrize("seed", range(4))
def test_closures_put_the_stretch_where_it_is(seed):
    rng, settled, truth, stretch = world(seed)
    found = closures(rng, settled, truth, [3, 9, 14, 20])
    assert (believed(found, stretch, settled, BeliefConfig()) == KEPT).all()
    poses, covariance = tied(found, stretch, settled)
    off = between(truth, poses)
    assert np.abs(off[:, :2]).max() < 0.03 and np.abs(off[:, 2]).max() < 0.02
    last = off[-1]
    assert last @ np.linalg.solve(covariance, last) < 25


def test_its_covariance_says_how_far_it_errs():
    squared = []
    for seed in range(24):
        rng, settled, truth, stretch = world(seed)
        poses, covariance = tied(closures(rng, settled, truth, [3, 9, 14, 20]), stretch, settled)
        off = between(truth[-1], poses[-1])
        squared.append(off @ np.linalg.solve(covariance, off))
    assert 1.0 < np.mean(squared) < 6.0


@pytest.mark.parametrize("rows", [[3], [20]])
def test_one_closure_alone_says_nothing(rows):
    rng, settled, truth, stretch = world(0)
    reasons = believed(closures(rng, settled, truth, rows), stretch, settled, BeliefConfig())
    assert reasons.tolist() == ["no other closure supports it"]


@pytest.mark.parametrize("off", [(1.0, 0.0, 0.0), (0.0, 0.4, 0.0), (0.0, 0.0, 0.3)])
def test_one_that_contradicts_the_others_is_not_believed(off):
    rng, settled, truth, stretch = world(1)
    good = closures(rng, settled, truth, [2, 8, 18])
    reasons = believed(both(good, closures(rng, settled, truth, [12], np.array(off))), stretch, settled, BeliefConfig())
    assert (reasons[:3] == KEPT).all() and reasons[3] == "contradicts the other closures"


def test_the_best_of_a_stretch_counts_and_weak_ones_do_not():
    rng, settled, truth, stretch = world(2)
    found = closures(rng, settled, truth, [6, 7, 14, 20])
    found.inliers[1], found.inliers[3] = 70, 12
    reasons = believed(found, stretch, settled, BeliefConfig())
    assert reasons.tolist() == [KEPT, "a better closure is near on the path", KEPT, "12 inliers, fewer than 20"]
    assert measured_well(found, BeliefConfig()).tolist() == [True, True, True, False]


def test_no_closures_are_none():
    rng, settled, truth, stretch = world(0)
    none = closures(rng, settled, truth, [0]).rows(np.zeros(0, int))
    assert len(believed(none, stretch, settled, BeliefConfig())) == 0
    assert not fits(*seen_in_map(none, settled), truth[0], np.eye(3), 11.3).any()


def test_a_closure_fits_where_it_says_what_is_expected():
    rng, settled, truth, _ = world(0)
    there, covariance = seen_in_map(closures(rng, settled, truth, [4, 9]), settled)
    good = fits(there, covariance, truth[4], np.diag(NOISE**2), 11.3)
    assert good.tolist() == [True, False]


def test_a_covariance_moves_on_as_samples_do():
    rng = np.random.default_rng(0)
    covariance, noise = np.diag([1e-4, 4e-4, 1e-4]), np.diag([1e-5, 1e-5, 1e-6])
    step = np.array([0.5, 0.1, 0.4])
    start = rng.multivariate_normal(np.zeros(3), covariance, 20000)
    moved = compose(
        compose(start, np.broadcast_to(step, start.shape)), rng.multivariate_normal(np.zeros(3), noise, 20000)
    )
    sampled = np.cov(between(np.broadcast_to(step, moved.shape), moved).T)
    np.testing.assert_allclose(moved_on(covariance, step, noise), sampled, atol=2e-5)
