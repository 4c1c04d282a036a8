import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.geometry.camera import FloorView, camera_over_floor
from ebjax.geometry.planar import between, chained
from ebjax.odometry.partners import REACH, SHARED, common_floor, partners, partners_of_last
from ebjax.views.run_view import RunView, choose_floor, from_camera, from_quad

CAMERA = camera_over_floor(380.0, 380.0, 319.5, 239.5, 640, 480, 0.54, np.radians(19), 0.0, 0.27)
METRIC = from_camera(CAMERA, choose_floor(CAMERA, 0.01))
QUAD = from_quad(CAMERA, np.array([[240, 240], [400, 240], [560, 460], [80, 460]], float), 0.25)
RECTANGLE = FloorView(1.0, 3.0, -1.0, 1.0, 0.02)
WHOLE = RunView(jnp.eye(3), jnp.asarray(RECTANGLE.floor_from_view), jnp.ones(RECTANGLE.size, bool))


def straight(count, step_m, turn_rad=0.0):
    return chained(np.tile([step_m, 0.0, turn_rad], (count - 1, 1)))


def gaps_of(rows):
    later, earlier = rows
    return {int(k): later[later == k] - earlier[later == k] for k in np.unique(later)}


@pytest.mark.parametrize("view", [METRIC, QUAD, WHOLE])
def test_a_view_shares_all_with_itself_and_nothing_with_one_far_away(view):
    away = np.array([[0, 0, 0], [6, 0, 0], [-6, 0, 0], [0, 5, 0], [0, -5, 0], [-1, 0, np.pi], [-3, 0, np.pi / 2]])
    shares = common_floor(view, away.astype(float))
    assert shares[0] == 1
    np.testing.assert_array_equal(shares[1:], 0)


@pytest.mark.parametrize("view", [METRIC, QUAD, WHOLE])
def test_the_share_falls_with_the_distance_and_with_the_turn(view):
    for direction in ([1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0], [0, 0, 1.0], [0, 0, -1.0]):
        shares = common_floor(view, np.linspace(0, 2.2, 12)[:, None] * np.array([direction]))
        # The points of the grid enter and leave one by one.
        assert (np.diff(shares) <= 0.03).all()
        assert shares[0] == 1 and shares[-1] < 0.35


def test_the_share_of_a_rectangle_is_the_overlap():
    for x, y in ((0.5, 0.0), (1.0, 0.0), (0.0, -0.5), (0.5, 0.5), (-1.0, 1.0)):
        overlap = (1 - abs(x) / 2) * (1 - abs(y) / 2)
        assert common_floor(WHOLE, np.array([[x, y, 0.0]]))[0] == pytest.approx(overlap, abs=0.07)
    # Two that look at the same floor from opposite sides.
    assert common_floor(WHOLE, np.array([[4.0, 0.0, np.pi]]))[0] > 0.95


def test_floor_that_is_not_seen_is_not_shared():
    seen = np.ones(RECTANGLE.size, bool)
    seen[:50] = False  # the far half
    half = dataclasses.replace(WHOLE, seen=jnp.asarray(seen))
    assert common_floor(half, np.zeros((1, 3)))[0] == 1
    ahead = np.array([[0.5, 0.0, 0.0]])
    assert common_floor(half, ahead)[0] == pytest.approx(0.5, abs=0.08)
    assert common_floor(WHOLE, ahead)[0] == pytest.approx(0.75, abs=0.05)
    np.testing.assert_array_equal(common_floor(half, np.array([[1.1, 0.0, 0.0], [-1.1, 0, 0]])), 0)


@pytest.mark.parametrize("step_m", [0.05, 0.2, 0.4, 0.8])
@pytest.mark.parametrize("view", [METRIC, QUAD, WHOLE])
def test_partners_are_the_one_before_and_at_most_two_that_share_less(view, step_m):
    poses = straight(40, step_m, 0.01)
    later, earlier = partners(view, poses)
    assert (earlier < later).all() and (earlier >= 0).all() and (later - earlier <= REACH).all()
    assert (np.diff(later) >= 0).all()
    assert len(set(zip(later, earlier, strict=True))) == len(later)
    assert np.unique(later, return_counts=True)[1].max(initial=0) <= 1 + len(SHARED)
    shares = common_floor(view, between(poses[later], poses[earlier]))
    np.testing.assert_array_equal(later[later - earlier == 1], np.arange(1, 40))
    far = later - earlier > 1
    assert (shares[far] >= min(SHARED)).all()


def test_the_farther_partners_are_the_farthest_that_still_share_so_much():
    poses = straight(30, 0.15)
    shares = [common_floor(WHOLE, between(poses[20:21], poses[20 - gap : 21 - gap]))[0] for gap in range(1, REACH + 1)]
    expected = {1} | {1 + int(np.flatnonzero(np.array(shares) >= wanted)[-1]) for wanted in SHARED}
    assert len(expected) == 3
    assert set(gaps_of(partners(WHOLE, poses))[20]) == expected


def test_a_robot_that_stands_is_measured_against_as_far_back_as_may_be():
    for later, gaps in gaps_of(partners(METRIC, np.zeros((20, 3)))).items():
        assert set(gaps) == {1, min(later, REACH)}


def test_over_a_leap_only_the_one_before_is_a_partner():
    poses = straight(20, 0.2)
    poses[10:, 0] += 5
    later, earlier = partners(METRIC, poses)
    over = (later >= 10) & (earlier < 10)
    assert later[over] == [10] and earlier[over] == [9]


@pytest.mark.parametrize("count", [1, 2])
def test_few_keyframes(count):
    later, earlier = partners(METRIC, straight(count, 0.1))
    np.testing.assert_array_equal(later, np.arange(1, count))
    np.testing.assert_array_equal(earlier, np.arange(count - 1))


@pytest.mark.parametrize(("count", "seed"), [(2, 0), (5, 1), (40, 2)])
def test_the_last_has_the_partners_that_it_has_among_all(count, seed):
    steps = np.random.default_rng(seed).normal([0.15, 0, 0], [0.05, 0.02, 0.2], (count - 1, 3))
    poses = chained(steps)
    later, earlier = partners(METRIC, poses)
    for k in range(1, count):
        np.testing.assert_array_equal(np.sort(partners_of_last(METRIC, poses[: k + 1])), np.sort(earlier[later == k]))
