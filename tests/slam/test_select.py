import dataclasses

import numpy as np
import pytest

from ebjax.odometry.wheels import WheelErrors
from ebjax.slam.select import (
    KEPT,
    Measured,
    SelectConfig,
    best_per_stretch,
    drift_sigma_m,
    odometry_distance,
    plausible,
    select,
    spread_along,
)

OUT = np.stack([np.arange(21) * 0.5, np.zeros(21), np.zeros(21)], 1)
PATH = np.concatenate([OUT, OUT[::-1] + np.array([0, 0.2, np.pi])])
STEPS = WheelErrors().step_covariance(PATH)


def true_candidates(pairs):
    i, j = np.array(pairs).T
    d = PATH[j] - PATH[i]
    c, s = np.cos(PATH[i, 2]), np.sin(PATH[i, 2])
    measured = np.stack([c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0], -d[:, 2]], 1)
    measured[:, 2] = np.pi
    count = len(i)
    covariance = np.tile(np.diag([0.005, 0.005, 0.002]) ** 2, (count, 1, 1))
    full = np.full(count, 60)
    return Measured(i, j, np.ones(count, bool), np.full(count, 0.3), full, full + 20, measured, covariance)


def spoiled(candidates, k, **changes):
    arrays = {}
    for name, value in changes.items():
        array = getattr(candidates, name).copy()
        array[k] = value
        arrays[name] = array
    return dataclasses.replace(candidates, **arrays)


@pytest.fixture
def good():
    return true_candidates([(25, 11), (28, 8), (31, 5), (34, 4)])


def test_true_closures_are_kept(good):
    assert select(good, PATH, STEPS, SelectConfig()) == [KEPT] * 4


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"inliers": 10}, "inliers"),
        ({"total": 500}, "ratio"),
        ({"covariance": np.eye(3)}, "uncertain"),
        ({"i_from_j": np.nan}, "no measurement"),
        ({"i_from_j": [9.0, 0.0, np.pi]}, "odometry"),
        ({"i_from_j": [0.4, 0.2, np.pi]}, "other closures"),
    ],
)
def test_every_rejection_has_its_reason(good, changes, word):
    if "i_from_j" in changes and word == "other closures":
        changes = {"i_from_j": good.i_from_j[1] + np.array([0.3, 0.0, 0.0])}
    reasons = select(spoiled(good, 1, **changes), PATH, STEPS, SelectConfig())
    assert word in reasons[1]
    assert [reasons[k] for k in (0, 2, 3)] == [KEPT] * 3


def test_neighbours_on_the_path_leave_the_best(good):
    close = true_candidates([(25, 11), (26, 10)])
    reasons = select(spoiled(close, 1, inliers=70), PATH, STEPS, SelectConfig(spacing_m=1.0, min_agreeing=1))
    assert reasons[1] == KEPT
    assert "better closure" in reasons[0]


def test_one_alone_is_not_believed():
    reasons = select(true_candidates([(25, 11)]), PATH, STEPS, SelectConfig())
    assert "supports" in reasons[0]
    assert select(true_candidates([(25, 11)]), PATH, STEPS, SelectConfig(min_agreeing=1)) == [KEPT]


def test_closures_with_one_and_the_same_view_do_not_support_each_other():
    same = true_candidates([(25, 8), (27, 8), (29, 8)])
    assert set(select(same, PATH, STEPS, SelectConfig())) == {"no other closure supports it"}


def test_top_spreads(good):
    reasons = select(good, PATH, STEPS, SelectConfig(top=2))
    assert reasons.count(KEPT) == 2


def test_no_candidate_at_all():
    empty = Measured(
        *(np.zeros(0, t) for t in (int, int, bool, float, int, int)), np.zeros((0, 3)), np.zeros((0, 3, 3))
    )
    assert select(empty, PATH, STEPS, SelectConfig()) == []


def test_the_distance_from_odometry_grows_with_the_error(good):
    steps = STEPS
    true = odometry_distance(good, PATH, steps)
    assert (true < 0.5).all()
    off = spoiled(good, 0, i_from_j=good.i_from_j[0] + np.array([1.0, 0, 0]))
    farther = spoiled(good, 0, i_from_j=good.i_from_j[0] + np.array([2.0, 0, 0]))
    assert true[0] < odometry_distance(off, PATH, steps)[0] < odometry_distance(farther, PATH, steps)[0]


def test_drift_is_what_random_steps_drift():
    rng = np.random.default_rng(0)
    errors = WheelErrors(heading_deg_per_sqrt_m=0.5)
    steps = errors.step_sigmas(PATH)
    local = np.diff(PATH, axis=0)
    c, s = np.cos(PATH[:-1, 2]), np.sin(PATH[:-1, 2])
    local[:, :2] = np.stack([c * local[:, 0] + s * local[:, 1], c * local[:, 1] - s * local[:, 0]], 1)
    walked = local[None] + rng.normal(size=(3000, *steps.shape)) * steps[None]
    heading = np.concatenate([np.zeros((3000, 1)), np.cumsum(walked[..., 2], 1)], 1)
    c, s = np.cos(heading[:, :-1]), np.sin(heading[:, :-1])
    x, y = walked[..., 0], walked[..., 1]
    moved = np.cumsum(np.stack([c * x - s * y, s * x + c * y], -1), 1)
    places = np.concatenate([np.zeros((3000, 1, 2)), moved], 1)
    for i, j in ((25, 11), (41, 0), (30, 28)):
        back = places[:, j] - places[:, i]
        turn = -heading[:, i]
        back = np.stack(
            [
                np.cos(turn) * back[:, 0] - np.sin(turn) * back[:, 1],
                np.sin(turn) * back[:, 0] + np.cos(turn) * back[:, 1],
            ],
            1,
        )
        spread = np.sqrt(back.var(0).sum())
        assert drift_sigma_m(PATH, errors.step_covariance(PATH), np.array([i]), np.array([j]))[0] == pytest.approx(
            spread, rel=0.1
        )


def test_what_odometry_rules_out():
    i, j = np.array([[25, 25]]), np.array([[11, 0]])
    centre = np.array([1.0, 0.0])
    np.testing.assert_array_equal(plausible(i, j, PATH, centre, 1.5, STEPS, 3.0), [[True, False]])
    assert plausible(i, j, PATH, centre, 1.5, WheelErrors(translation=1.0).step_covariance(PATH), 3.0).all()


def test_best_per_stretch_keeps_the_spacing():
    rng = np.random.default_rng(0)
    place, quality = np.sort(rng.uniform(0, 20, 200)), rng.uniform(0, 1, 200)
    chosen = best_per_stretch(place, quality, 0.5)
    assert chosen[np.argmax(quality)]
    assert (np.diff(place[chosen]) >= 0.5).all()
    for k in np.flatnonzero(~chosen):
        rivals = chosen & (np.abs(place - place[k]) < 0.5)
        assert quality[rivals].max() >= quality[k]


def test_spread_along_fills_up():
    place, quality = np.array([0.0, 0.1, 0.2, 10.0]), np.array([1.0, 3.0, 2.0, 0.5])
    np.testing.assert_array_equal(spread_along(place, quality, 2), [False, True, False, True])
    np.testing.assert_array_equal(spread_along(place, quality, 3), [False, True, True, True])
