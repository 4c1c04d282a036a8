import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.features.landmarks import Landmarks
from ebjax.features.matching import Features
from ebjax.geometry.camera import camera_over_floor
from ebjax.geometry.planar import between, chained, compose, inverse
from ebjax.odometry.height import PRIOR_M, Reach
from ebjax.odometry.self_check import (
    height_off,
    measured_scale,
    mount_warnings,
    moved_camera,
    offset_of,
    reach_of,
    systematic_of,
)
from ebjax.odometry.steps import USED, Steps
from ebjax.odometry.wheels import Systematic, WheelErrors

CAMERA = camera_over_floor(400.0, 400.0, 320.0, 240.0, 640, 480, 0.6, 0.5, 0.0, 0.2)
GOOD = WheelErrors(translation=0.005, heading_deg_per_sqrt_m=0.3, turning=0.005, scale_sigma=0.002)
COUNT = 80


def landmarks(floor_z=None):
    """Of two keyframes; depth, if any, sees the floor at that height."""
    points = np.zeros((2, 30, 3))
    points[..., 2] = 0.0 if floor_z is None else floor_z
    ranges = np.zeros((2, 30)) if floor_z is None else np.tile(np.arange(30) % 3 > 0, (2, 1)) * 1.5
    points[ranges == 0] = 9.0
    features = Features(np.zeros((2, 30, 2)), np.ones((2, 30, 4)), np.ones((2, 30), bool))
    return Landmarks(features, points[..., :2], points, ranges, np.zeros((2, 30, 2)), np.zeros((2, 9, 9), np.uint8))


def systematic(scale, sigma=0.003):
    return Systematic(scale, 1.0, 0.0, 0.0, (sigma, 0.01, 0.1, 0.01), 100)


@pytest.mark.parametrize("scale,percent", [(1.07, "+7 %"), (0.93, "-7 %")])
def test_a_scale_that_is_far_off_is_warned_of(scale, percent):
    (said,) = mount_warnings(systematic(scale), False, landmarks(), CAMERA, WheelErrors())
    for word in (percent, "0.600 m", "T_base_camera", "measure the height"):
        assert word in said


def test_a_small_or_uncertain_scale_is_not_warned_of():
    assert mount_warnings(systematic(1.02), False, landmarks(), CAMERA, WheelErrors()) == ()
    assert mount_warnings(systematic(1.07, 0.03), False, landmarks(), CAMERA, WheelErrors()) == ()
    assert mount_warnings(None, False, landmarks(), CAMERA, WheelErrors()) == ()
    assert mount_warnings(Systematic(), False, landmarks(), CAMERA, WheelErrors()) == ()


def test_depth_that_contradicts_the_height_is_warned_of():
    (said,) = mount_warnings(None, True, landmarks(0.06), CAMERA, WheelErrors())
    for word in ("+0.060 m", "0.600 m", "10 %", "correct the height", "--floor depth"):
        assert word in said
    assert mount_warnings(None, False, landmarks(0.06), CAMERA, WheelErrors()) == ()
    assert mount_warnings(None, True, landmarks(0.02), CAMERA, WheelErrors()) == ()
    assert len(mount_warnings(systematic(1.07), True, landmarks(0.06), CAMERA, WheelErrors())) == 2


def test_height_off_counts_only_what_has_depth():
    assert height_off(landmarks(), CAMERA) == 0.0
    assert height_off(landmarks(-0.03), CAMERA) == pytest.approx(0.05)


def test_moved_camera_is_moved_by_what_was_found():
    pose = np.asarray(moved_camera(CAMERA, Reach(0.02, -0.03)).base_from_camera)
    expected = camera_over_floor(400.0, 400.0, 320.0, 240.0, 640, 480, 0.62, 0.5, 0.0, 0.17)
    np.testing.assert_allclose(pose, expected.base_from_camera, atol=1e-12)


def drive(seed=0, count=COUNT):
    """True steps, earlier_from_later: both ways round, so that gain and bend are told apart."""
    random = np.random.default_rng(seed)
    metres, turned = random.uniform(0.1, 0.25, count - 1), random.uniform(-0.3, 0.3, count - 1)
    return np.stack([metres * np.cos(turned / 2), metres * np.sin(turned / 2), turned], 1)


def steps_of(moved, sigma=0.0005):
    """The table of steps that moved so, and of some that do not count."""
    rows = np.arange(len(moved))
    covariance = np.tile(sigma**2 * np.eye(3), (len(moved), 1, 1))
    random = np.random.default_rng(5)
    i_from_j = inverse(compose(moved, sigma * random.standard_normal(moved.shape)))
    fifty = np.full(len(moved), 50)
    kind, reason = np.full(len(moved), "floor", object), np.full(len(moved), USED, object)
    kind[::9], i_from_j[::9, :2] = "rotation", 0.0
    reason[4::9], i_from_j[4::9] = "few matches", 1.0
    return Steps(rows + 1, rows, kind, fifty, fifty, i_from_j, covariance, reason)


def test_systematic_of_reads_the_used_steps_that_tell_translation():
    moved = drive()
    wheels = chained(moved / [1.04, 1.04, 0.95])
    found = systematic_of(steps_of(moved), wheels, np.arange(COUNT) * 0.5, WheelErrors())
    assert found.steps == COUNT - 1 - 9 - 9
    assert found.scale == pytest.approx(1.04, abs=0.01)
    assert found.gain == pytest.approx(0.95, abs=0.01)


@pytest.mark.parametrize("declared", [0.002, 0.03])
def test_the_measured_scale_does_not_depend_on_what_was_expected(declared):
    moved, errors = drive(), dataclasses.replace(GOOD, scale_sigma=declared)
    wrong = systematic_of(steps_of(moved), chained(moved / [1.04, 1.04, 1.0]), np.arange(COUNT) * 0.5, errors)
    scale, sigma = measured_scale(wrong, errors)
    assert scale == pytest.approx(1.04, abs=0.002)
    assert sigma < 0.003
    # Nothing measured is nothing known.
    assert measured_scale(Systematic(sigma=(declared, 1.0, 1.0, 1.0)), errors)[0] == 1.0
    assert measured_scale(Systematic(sigma=(declared, 1.0, 1.0, 1.0)), errors)[1] > 10 * declared


def test_offset_of_adds_to_the_images_stamps():
    fine = np.arange(-3.0, 60.0, 0.02)
    heading = np.cumsum(0.6 * np.sin(0.9 * fine) * np.sin(0.23 * fine)) * 0.02
    moments = np.arange(0.0, 55.0, 0.4)

    def path(times):
        return np.stack([0.4 * times, 0 * times, np.interp(times, fine, heading)], 1)

    at = path(moments)
    steps = steps_of(between(at[:-1], at[1:]))
    found = offset_of(steps, lambda offset: path(moments + 0.3 + offset), GOOD)
    assert found.offset_s == pytest.approx(-0.3, abs=0.03)
    assert found.sigma_s < 0.03


@pytest.mark.parametrize("ahead", [0.05, -0.04])
def test_reach_puts_the_camera_where_it_stands(ahead):
    moved = drive()
    shift = np.broadcast_to([ahead, 0.0, 0.0], moved.shape)
    seen = compose(compose(inverse(shift), moved), shift)
    wheels = chained(moved)
    steps = steps_of(seen)
    wrong = systematic_of(steps, wheels, np.arange(COUNT) * 0.5, GOOD)
    reach = reach_of(steps, landmarks(), CAMERA, wheels, wrong, GOOD)
    assert reach.x_m == pytest.approx(ahead, abs=0.015)
    x = float(np.asarray(moved_camera(CAMERA, reach).base_from_camera)[0, 3])
    assert abs(x - (0.2 + ahead)) < 0.3 * abs(ahead)


def test_reach_takes_the_height_of_depth_before_that_of_wheels():
    moved = drive()
    wheels, steps = chained(moved), steps_of(moved * [0.95, 0.95, 1.0])
    wrong = systematic_of(steps, wheels, np.arange(COUNT) * 0.5, GOOD)
    by_wheels = reach_of(steps, landmarks(), CAMERA, wheels, wrong, GOOD)
    # Steps come out 5 % short where the true camera stands 5 % higher: wheels this good leave no doubt of it.
    assert by_wheels.height_m == pytest.approx(0.6 / 0.95 - 0.6, abs=0.002)
    assert by_wheels.height_sigma_m < 0.002
    by_depth = reach_of(steps, landmarks(-0.02), CAMERA, wheels, wrong, GOOD)
    assert by_depth.height_m == pytest.approx(0.02, abs=0.003)
    neither = reach_of(steps, landmarks(), CAMERA, None, None, GOOD)
    assert neither == Reach(0.0, 0.0, PRIOR_M, PRIOR_M)


def test_what_may_as_well_be_nothing_stays():
    moved = drive()
    wheels, steps = chained(moved), steps_of(moved)
    wrong = systematic_of(steps, wheels, np.arange(COUNT) * 0.5, GOOD)
    reach = reach_of(steps, landmarks(0.001), CAMERA, wheels, wrong, GOOD)
    assert (reach.height_m, reach.x_m) == (0.0, 0.0)
    same = moved_camera(dataclasses.replace(CAMERA, intrinsics=jnp.asarray(CAMERA.intrinsics)), reach)
    np.testing.assert_array_equal(same.base_from_camera, CAMERA.base_from_camera)
