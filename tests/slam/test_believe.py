import dataclasses

import numpy as np
import pytest

from ebjax.geometry.planar import between
from ebjax.odometry.wheels import WheelErrors
from ebjax.slam.believe import KEPT, THINNED, Belief, BeliefConfig, alone_reasons, spread_along
from ebjax.slam.gate import drift_sigma_m, odometry_distance, plausible
from ebjax.slam.measured import Measured
from ebjax.slam.walked import Walked

OUT = np.stack([np.arange(21) * 0.5, np.zeros(21), np.zeros(21)], 1)
PATH = np.concatenate([OUT, OUT[::-1] + np.array([0, 0.2, np.pi])])
STEPS = WheelErrors().step_covariance(PATH)
WALKED = Walked(PATH, STEPS, np.zeros(len(PATH), int))


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


def believed(candidates, config):
    belief = Belief(config)
    belief.update(candidates, WALKED)
    return belief.reasons.tolist()


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
    assert believed(good, BeliefConfig()) == [KEPT] * 4


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
    reasons = believed(spoiled(good, 1, **changes), BeliefConfig())
    assert word in reasons[1]
    assert [reasons[k] for k in (0, 2, 3)] == [KEPT] * 3


def test_neighbours_on_the_path_leave_the_best(good):
    close = true_candidates([(25, 11), (26, 10)])
    reasons = believed(spoiled(close, 1, inliers=70), BeliefConfig(spacing_m=1.0, min_agreeing=1))
    assert reasons[1] == KEPT
    assert "better closure" in reasons[0]


def test_one_alone_is_not_believed():
    reasons = believed(true_candidates([(25, 11)]), BeliefConfig())
    assert "supports" in reasons[0]
    assert believed(true_candidates([(25, 11)]), BeliefConfig(min_agreeing=1)) == [KEPT]


def test_closures_with_one_and_the_same_view_do_not_support_each_other():
    same = true_candidates([(25, 8), (27, 8), (29, 8)])
    assert set(believed(same, BeliefConfig())) == {"no other closure supports it"}


def test_top_spreads(good):
    reasons = believed(good, BeliefConfig(top=2))
    assert reasons.count(KEPT) == 2


def test_no_candidate_at_all():
    empty = Measured(
        *(np.zeros(0, t) for t in (int, int, bool, float, int, int)), np.zeros((0, 3)), np.zeros((0, 3, 3))
    )
    assert believed(empty, BeliefConfig()) == []


def distance(c, steps):
    return odometry_distance(c.i, c.j, c.i_from_j, c.covariance, PATH, steps)


def test_the_distance_from_odometry_grows_with_the_error(good):
    steps = STEPS
    true = distance(good, steps)
    assert (true < 0.5).all()
    off = spoiled(good, 0, i_from_j=good.i_from_j[0] + np.array([1.0, 0, 0]))
    farther = spoiled(good, 0, i_from_j=good.i_from_j[0] + np.array([2.0, 0, 0]))
    assert true[0] < distance(off, steps)[0] < distance(farther, steps)[0]


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
    i, j, facing = np.array([25, 25]), np.array([11, 0]), np.array([True, True])
    view = np.array([1.0, 0.0]), 1.5
    np.testing.assert_array_equal(plausible(i, j, facing, PATH, *view, STEPS, 3.0), [True, False])
    loose = WheelErrors(translation=1.0).step_covariance(PATH)
    assert plausible(i, j, facing, PATH, *view, loose, 3.0).all()
    # The same places, but claimed to have been seen in the same direction.
    assert not plausible(i, j, ~facing, PATH, *view, loose, 3.0).any()
    np.testing.assert_array_equal(plausible(i, j, None, PATH, *view, STEPS, 3.0), [True, False])
    lost = WheelErrors(translation=1.0, heading_deg_per_sqrt_m=60.0).step_covariance(PATH)
    assert plausible(i, j, ~facing, PATH, *view, lost, 3.0).all()


@pytest.mark.parametrize("spacing_m", [0.3, 1.0])
def test_the_best_of_every_stretch_is_left(spacing_m):
    candidates, path, _ = many(200, 0.0)
    belief = Belief(BeliefConfig(spacing_m=spacing_m))
    belief.update(candidates, path)
    alone = alone_reasons(candidates, path, BeliefConfig()) == ""
    left = alone & (belief.reasons != THINNED)
    stretch = np.floor(path.travelled[candidates.i] / spacing_m).astype(int)
    for one in np.unique(stretch[alone]):
        mine = alone & (stretch == one)
        assert left[mine].sum() == 1
        assert candidates.quality[mine & left] == candidates.quality[mine].max()


def test_spread_along_fills_up():
    place, quality = np.array([0.0, 0.1, 0.2, 10.0]), np.array([1.0, 3.0, 2.0, 0.5])
    np.testing.assert_array_equal(spread_along(place, quality, 2), [False, True, False, True])
    np.testing.assert_array_equal(spread_along(place, quality, 3), [False, True, True, True])


def many(count, wrong, seed=0):
    """Closures along a long way out and back, some of them wrong."""
    random = np.random.default_rng(seed)
    out = np.stack([np.arange(3 * count) * 0.25, np.zeros(3 * count), np.zeros(3 * count)], 1)
    path = np.concatenate([out, out[::-1] * [1, 1, 0] + [0, 0.2, np.pi]])
    i = np.sort(random.integers(3 * count + 8, 6 * count, count))
    j = np.clip(6 * count - 1 - i + random.integers(-2, 3, count), 0, 3 * count - 1)
    measured = between(path[i], path[j]) + random.normal(size=(count, 3)) * [0.004, 0.004, 0.001]
    false = random.random(count) < wrong
    measured[false] += random.uniform(-0.6, 0.6, (int(false.sum()), 3)) * [1, 1, 0.1]
    covariance = np.tile(np.diag([0.005, 0.005, 0.002]) ** 2, (count, 1, 1))
    inliers = random.integers(15, 120, count)
    candidates = Measured(
        i, j, np.ones(count, bool), np.full(count, 0.3), inliers, inliers + random.integers(0, 60, count), measured,
        covariance,
    )  # fmt: skip
    steps = WheelErrors(heading_deg_per_sqrt_m=0.1, translation=0.003).step_covariance(path)
    return candidates, Walked(path, steps, np.zeros(len(path), int)), false


def up_to(path, row):
    return Walked(path.poses[: row + 1], path.steps[:row], path.piece[: row + 1])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("count", "wrong", "seed", "top"),
    [(12, 0.3, 0, 0), (90, 0.2, 1, 0), (300, 0.3, 2, 0), (300, 0.0, 3, 0), (300, 0.1, 4, 30), (400, 0.2, 5, 0)],
)
def test_what_is_believed_does_not_depend_on_how_it_came(count, wrong, seed, top):
    candidates, path, _ = many(count, wrong, seed)
    if seed > 3:
        # Two pieces of path before, and the later one goes on.
        path = dataclasses.replace(path, piece=np.where(np.arange(len(path.poses)) < 2 * count, 0, 1))
    whole = Belief(BeliefConfig(top=top))
    whole.update(candidates, path)
    came, so_far = Belief(BeliefConfig(top=top)), up_to(path, 0)
    for row in np.unique(candidates.i):
        part = up_to(path, int(row))
        so_far = so_far.gone_on(part.poses, part.steps, part.piece)
        came.update(candidates.rows(np.flatnonzero(candidates.i <= row)), so_far)
    np.testing.assert_array_equal(came.reasons, whole.reasons)


@pytest.mark.parametrize("seed", range(3))
def test_false_closures_among_hundreds_are_left_out(seed):
    candidates, path, false = many(300, 0.3, seed)
    belief = Belief(BeliefConfig())
    belief.update(candidates, path)
    off = np.abs(candidates.i_from_j - between(path.poses[candidates.i], path.poses[candidates.j]))[:, :2].max(1)
    assert belief.kept.sum() > 60
    assert off[belief.kept & false].max(initial=0) < 0.05


def test_a_closure_believed_early_is_taken_back():
    i, j = np.array([22, 24, 26, 28, 30, 32, 34]), np.array([19, 17, 15, 13, 11, 9, 7])
    candidates = true_candidates(list(zip(i, j, strict=True)))
    moved = candidates.i_from_j.copy()
    moved[:2, 0] += 0.25
    candidates = dataclasses.replace(candidates, i_from_j=moved)
    early, late = Belief(BeliefConfig()), Belief(BeliefConfig())
    early.update(candidates.rows(np.arange(2)), WALKED)
    assert early.kept.tolist() == [True, True]
    early.update(candidates, WALKED)
    late.update(candidates, WALKED)
    assert early.kept.tolist() == [False] * 2 + [True] * 5
    np.testing.assert_array_equal(early.reasons, late.reasons)


def test_pieces_of_path_that_nothing_joins_are_not_asked_of_odometry():
    candidates = true_candidates([(25, 11), (28, 8), (31, 5), (34, 4)])
    apart = Walked(PATH + np.where(np.arange(42) > 20, 50.0, 0.0)[:, None] * [1, 1, 0], STEPS, np.arange(42) // 21)
    together = Walked(apart.poses, STEPS, np.zeros(42, int))
    belief, contradicted = Belief(BeliefConfig()), Belief(BeliefConfig())
    belief.update(candidates, apart)
    contradicted.update(candidates, together)
    assert belief.kept.all()
    assert not contradicted.kept.any()


def test_a_path_that_is_gone_on_sums_up_to_the_same_bits():
    _, path, _ = many(40, 0.0)
    path = dataclasses.replace(path, piece=np.arange(len(path.poses)) // 100)
    grown = up_to(path, 0)
    for row in (1, 2, 3, 50, 51, 160, len(path.poses) - 1):
        part = up_to(path, row)
        grown = grown.gone_on(part.poses, part.steps, part.piece)
    np.testing.assert_array_equal(grown.travelled, path.travelled)
    np.testing.assert_array_equal(grown.spread, path.spread)
