import dataclasses

import numpy as np
import pytest

from ebjax.features.settle import PairMatches
from ebjax.features.verify_pairs import rows_of, settle_all
from ebjax.geometry.camera import camera_over_floor, project
from ebjax.geometry.planar import between, chained, compose
from ebjax.odometry.floor_steps import (
    MIN_DEPTH,
    NOT_THE_FLOOR,
    NOT_THE_WHEELS,
    FloorPairs,
    table_of,
    without_body,
    without_contradiction,
)
from ebjax.odometry.steps import USED, Steps
from ebjax.odometry.wheels import WheelErrors

ERRORS = WheelErrors()
COUNT = 20
FIFTH = 7


def table(i_from_j, kind="floor", sigma=0.002):
    """Used steps, one from each keyframe before."""
    rows = np.arange(len(i_from_j))
    covariance = np.tile(np.diag([sigma**2, sigma**2, (sigma / 2) ** 2]), (len(rows), 1, 1))
    full = np.full(len(rows), 50)
    return Steps(
        rows + 1, rows, np.full(len(rows), kind, object), full, full, i_from_j, covariance,
        np.full(len(rows), USED, object),
    )  # fmt: skip


def wheels_of(step, count=COUNT):
    """A path of equal steps."""
    return chained(np.tile(np.array(step, float), (count - 1, 1)))


def views_of(count=COUNT):
    """A texture that moves by."""
    texture = np.random.default_rng(0).integers(0, 256, (24, 24 + 8 * count, 3), np.uint8)
    return [texture[:, 8 * k : 8 * k + 24] for k in range(count)]


def stood_still(wheels, at=FIFTH):
    """Steps as the wheels have them, but one of no motion."""
    i_from_j = between(wheels[1:], wheels[:-1])
    i_from_j[at - 1] = [0.001, 0, 0]
    return table(i_from_j)


@pytest.mark.parametrize("step", [(0.15, 0, 0), (0.15, 0, 0.1), (0, 0, 0.3)])
def test_matches_that_stand_still_while_the_floor_moves_are_not_of_the_floor(step):
    wheels = wheels_of(step)
    steps = without_body(stood_still(wheels), wheels, views_of(), ERRORS)
    assert steps.reason[FIFTH - 1] == NOT_THE_FLOOR
    assert steps.used.sum() == COUNT - 2


def test_a_frozen_camera_says_nothing():
    wheels, views = wheels_of((0.15, 0, 0)), views_of()
    views[FIFTH] = views[FIFTH - 1]
    assert without_body(stood_still(wheels), wheels, views, ERRORS).reason[FIFTH - 1] == NOT_THE_FLOOR


def test_a_robot_that_is_stuck_is_believed():
    wheels, views = wheels_of((0.15, 0, 0)), views_of()
    noise = np.random.default_rng(1).integers(-3, 4, views[0].shape)
    views[FIFTH] = np.clip(views[FIFTH - 1].astype(int) + noise, 0, 255).astype(np.uint8)
    steps = stood_still(wheels)
    np.testing.assert_array_equal(without_body(steps, wheels, views, ERRORS).reason, steps.reason)


def test_steps_that_move_and_wheels_that_rest_are_left_alone():
    wheels = wheels_of((0.15, 0, 0.02))
    moving = table(between(wheels[1:], wheels[:-1]))
    assert without_body(moving, wheels, views_of(), ERRORS).used.all()
    rest = wheels_of((0.005, 0, 0.005))
    still = table(np.zeros((COUNT - 1, 3)))
    assert without_body(still, rest, views_of(), ERRORS).used.all()


def test_what_is_refused_already_keeps_its_reason():
    wheels = wheels_of((0.15, 0, 0))
    steps = stood_still(wheels).refuse(np.arange(COUNT - 1) == FIFTH - 1, "uncertain")
    assert without_body(steps, wheels, views_of(), ERRORS).reason[FIFTH - 1] == "uncertain"


@pytest.mark.parametrize("kind", ["image", "rotation"])
@pytest.mark.parametrize("wrong", [(0.3, 0, 0), (0, 0, 0.5)])
def test_an_image_that_contradicts_ordinary_wheels_is_refused(kind, wrong):
    wheels = wheels_of((0.15, 0, 0.05))
    steps = table(between(wheels[1:], wheels[:-1]), kind, 0.005)
    steps.i_from_j[FIFTH] = compose(steps.i_from_j[FIFTH], np.array(wrong, float))
    found = without_contradiction(steps, wheels, ERRORS)
    assert found.reason[FIFTH] == NOT_THE_WHEELS
    assert found.used.sum() == COUNT - 2


def test_the_floor_is_not_refused_by_the_wheels():
    wheels = wheels_of((0.15, 0, 0.05))
    steps = table(between(wheels[1:], wheels[:-1]))
    steps.i_from_j[FIFTH] = [0.3, 0, 0.5]
    assert without_contradiction(steps, wheels, ERRORS).used.all()


def test_an_image_is_believed_where_the_wheels_jump():
    true = wheels_of((0.15, 0, 0.05))
    steps = table(between(true[1:], true[:-1]), "image", 0.005)
    wheels = true.copy()
    wheels[FIFTH + 1 :] += [3.0, -2.0, 0.0]
    assert without_contradiction(steps, wheels, ERRORS).used.all()


@pytest.mark.parametrize("seed", range(3))
def test_wheels_that_err_as_they_may_contradict_nothing(seed):
    random = np.random.default_rng(seed)
    true = wheels_of((0.15, 0, 0.05))
    i_from_j = between(true[1:], true[:-1]) + 0.005 * random.standard_normal((COUNT - 1, 3)) * [1, 1, 0.5]
    moved = between(true[:-1], true[1:])
    wheels = chained(moved + ERRORS.step_sigmas(true) * random.standard_normal(moved.shape))
    assert without_contradiction(table(i_from_j, "image", 0.005), wheels, ERRORS).used.all()


def test_longer_steps_may_differ_by_more():
    wheels = wheels_of((0.15, 0, 0.0))
    start = table(between(wheels[1:], wheels[:-1]), "image", 0.005)
    columns = [getattr(start, f.name)[:-3].copy() for f in dataclasses.fields(Steps)]
    steps = Steps(columns[0] + 3, *columns[1:])
    steps.i_from_j[:] = between(wheels[steps.i], wheels[steps.j]) + np.array([0, 0.035, 0])
    assert without_contradiction(steps, wheels, ERRORS).used.all()
    start.i_from_j[:] += [0, 0.035, 0]
    assert not without_contradiction(start, wheels, ERRORS).used.any()


CAMERA = camera_over_floor(400.0, 400.0, 320.0, 240.0, 640, 480, 0.6, 0.5, 0.0, 0.2)
LOW = camera_over_floor(400.0, 400.0, 320.0, 240.0, 640, 480, 0.54, 0.5, 0.0, 0.2)
MOTION = np.array([-0.3, 0.02, 0.05])
MATCHES = 60


def pairs_of(deep, count=5, noise_px=0.1, noise_depth=0.0005):
    """Pairs that moved by MOTION; the first `deep` matches of each have depth."""
    random = np.random.default_rng(3)
    c, s = np.cos(MOTION[2]), np.sin(MOTION[2])
    pose = np.asarray(CAMERA.base_from_camera)
    ends, points = ([], []), ([], [])
    for _ in range(count):
        j = random.uniform([0.9, -0.4], [1.9, 0.4], (MATCHES, 2))
        i = j @ np.array([[c, s], [-s, c]]) + MOTION[:2]
        for side, flat in enumerate((i, j)):
            solid = np.concatenate([flat, np.zeros((MATCHES, 1))], 1)
            pixels, _ = project(CAMERA, solid)
            lifted = (solid - pose[:3, 3]) @ pose[:3, :3]
            lifted *= 1 + noise_depth * random.standard_normal((MATCHES, 1)) * lifted[:, 2:]
            lifted[deep:] = 0
            ends[side].append(np.asarray(pixels) + noise_px * random.standard_normal((MATCHES, 2)))
            points[side].append(lifted)
    return PairMatches(
        *(np.stack(pixels) for pixels in ends),
        *(np.stack(lifted) for lifted in points),
        np.ones((count, MATCHES), bool),
        np.tile(MOTION, (count, 1)),
        np.tile(np.eye(2), (count, MATCHES, 1, 1)),
    )


def apart(i_from_j):
    """From MOTION, m and rad."""
    return np.abs(between(np.broadcast_to(MOTION, i_from_j.shape), i_from_j)).max(0)


def test_without_depth_the_floor_measures():
    i_from_j, covariance, by_depth = measured(pairs_of(0), CAMERA, 0.02, True)
    assert not by_depth.any()
    assert (apart(i_from_j) < [0.003, 0.003, 0.003]).all()
    assert (np.linalg.eigvalsh(covariance) > 0).all()


def measured(matches, camera, tolerance_m, trust=False):
    count = np.arange(len(matches.start))
    return FloorPairs(count, count, count, count, rows_of(matches)).measured(camera, tolerance_m, trust)


def test_few_points_with_depth_do_not_count():
    for trust in (False, True):
        assert not measured(pairs_of(MIN_DEPTH - 1), CAMERA, 0.02, trust)[2].any()
    assert measured(pairs_of(MIN_DEPTH), CAMERA, 0.02, True)[2].all()


@pytest.mark.parametrize("deep", [MIN_DEPTH, MATCHES // 2, MATCHES])
def test_untrusted_depth_is_taken_where_it_is_more_certain(deep):
    matches = pairs_of(deep)
    i_from_j, covariance, by_depth = measured(matches, CAMERA, 0.02)
    settled = settle_all(rows_of(matches), len(matches.start), CAMERA, 0.02)
    floor, depth = settled.floor, settled.depth
    np.testing.assert_array_equal(settled.with_depth, deep)
    smaller = np.minimum(*(np.trace(m.covariance[:, :2, :2], axis1=1, axis2=2) for m in (floor, depth)))
    np.testing.assert_allclose(np.trace(covariance[:, :2, :2], axis1=1, axis2=2), smaller)
    chosen = np.where(by_depth[:, None], depth.i_from_j, floor.i_from_j)
    np.testing.assert_array_equal(i_from_j, chosen)


def test_trusted_depth_does_not_mind_a_wrong_height():
    # What verification finds under that height.
    low = pairs_of(MATCHES).start * [0.95, 0.95, 1.0]
    matches, without = (dataclasses.replace(pairs_of(deep), start=low) for deep in (MATCHES, 0))
    by_floor = measured(without, LOW, 0.02)[0]
    i_from_j, _, by_depth = measured(matches, LOW, 0.02, True)
    assert by_depth.all()
    assert (apart(i_from_j) < [0.004, 0.004, 0.004]).all()
    # The floor's metres shrink with the height.
    np.testing.assert_allclose(by_floor[:, 0], 0.9 * MOTION[0], atol=0.004)


@pytest.mark.parametrize("trust,kind", [(True, "depth"), (False, None)])
def test_table_of_names_what_measured_and_judges_it(trust, kind):
    matches = pairs_of(MIN_DEPTH)
    i = np.arange(1, 6)
    inliers, total = np.array([60, 60, 19, 60, 24]), np.array([60, 60, 20, 60, 61])
    steps = table_of(FloorPairs(i, i - 1, inliers, total, rows_of(matches)), CAMERA, 0.02, trust)
    np.testing.assert_array_equal(steps.i, i)
    assert list(steps.reason[[0, 1, 3]]) == [USED] * 3
    assert steps.reason[2] == "few matches" and steps.reason[4] == "few of the matches agree"
    by_depth = measured(matches, CAMERA, 0.02, trust)[2]
    assert list(steps.kind) == [kind or ("depth" if deep else "floor") for deep in by_depth]


def test_pairs_are_believed_by_their_matches():
    i = np.arange(1, 6)
    pairs = FloorPairs(i, i - 1, np.array([20, 19, 40, 39, 0]), np.array([50, 20, 100, 100, 0]), rows_of(pairs_of(0)))
    np.testing.assert_array_equal(pairs.believed, [True, False, True, False, False])
