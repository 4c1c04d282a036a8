import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.features.settle import on_floor
from ebjax.geometry.camera import camera_over_floor, project
from ebjax.geometry.rigid import kabsch
from ebjax.odometry.height import (
    DEPTH_SHARE,
    PRIOR_M,
    Reach,
    height_from_depth,
    height_from_wheels,
    x_from_turns,
)

NUMBERS = (500.0, 500.0, 320.0, 240.0, 640, 480)


def posterior(density, grid):
    """Mean and standard deviation of an unnormalised density on an even grid."""
    weight = density / density.sum()
    mean = float(weight @ grid)
    return mean, float(np.sqrt(weight @ (grid - mean) ** 2))


@pytest.mark.parametrize("height,ratio,sigma,scale", [(0.5, 1.04, 0.004, 0.03), (0.9, 0.97, 0.02, 0.01)])
def test_height_from_wheels_is_the_posterior(height, ratio, sigma, scale):
    true = np.linspace(-0.2, 0.2, 2001)  # log(true / given height)
    wheels = np.linspace(-0.2, 0.2, 2001)  # log(driven / counted)
    both = np.exp(
        -0.5 * ((np.log(ratio) + true[:, None] - wheels[None, :]) / sigma) ** 2
        - 0.5 * (true[:, None] / (PRIOR_M / height)) ** 2
        - 0.5 * (wheels[None, :] / scale) ** 2
    )
    mean, deviation = posterior(both.sum(1), true)
    found, found_sigma = height_from_wheels(height, ratio, sigma, scale)
    assert found == pytest.approx(height * np.expm1(mean), rel=1e-5)
    assert found_sigma == pytest.approx(height * deviation, rel=1e-5)


def seen(true, thought, points):
    """Where a camera thought to be elsewhere puts points of the floor."""
    pixels, _ = project(true, np.concatenate([points, np.zeros((len(points), 1))], 1))
    return np.asarray(on_floor(pixels, thought))


def test_good_wheels_tell_the_height_of_a_camera():
    given, true = 0.60, 0.57
    thought, there = (camera_over_floor(*NUMBERS, height, 0.5) for height in (given, true))
    points = np.random.default_rng(0).uniform([0.8, -0.4], [1.6, 0.4], (50, 2))
    step = np.array([0.2, 0.0])
    moved = np.median(seen(there, thought, points + step)[:, 0] - seen(there, thought, points)[:, 0])
    found, sigma = height_from_wheels(given, float(moved) / 0.2, 1e-4, 1e-3)
    assert given + found == pytest.approx(true, abs=3 * sigma)
    assert sigma < 0.002
    # Wheels as uncertain as the height share what is wrong.
    half, _ = height_from_wheels(given, float(moved) / 0.2, 1e-6, PRIOR_M / given)
    assert np.log1p(half / given) == pytest.approx(np.log(true / given) / 2, rel=1e-6)


@pytest.mark.parametrize("height,z", [(0.5, 0.03), (1.2, -0.02)])
def test_height_from_depth_is_the_posterior(height, z):
    grid = np.linspace(-0.2, 0.2, 4001)  # what is to be added
    density = np.exp(-0.5 * (grid / PRIOR_M) ** 2 - 0.5 * ((z + grid) / (DEPTH_SHARE * height)) ** 2)
    mean, deviation = posterior(density, grid)
    found, sigma = height_from_depth(height, np.array([z, z + 1.0, z - 0.5, z, z]))
    assert found == pytest.approx(mean, rel=1e-5)
    assert sigma == pytest.approx(deviation, rel=1e-5)


def test_depth_puts_the_floor_under_the_camera():
    given, true = 0.60, 0.57
    camera = np.asarray(camera_over_floor(*NUMBERS, true, 0.5).base_from_camera)
    floor = np.concatenate([np.random.default_rng(1).uniform([0.8, -0.4], [1.6, 0.4], (40, 2)), np.zeros((40, 1))], 1)
    in_camera = (floor - camera[:3, 3]) @ camera[:3, :3]
    thought = np.asarray(camera_over_floor(*NUMBERS, given, 0.5).base_from_camera)
    z = (in_camera @ thought[:3, :3].T + thought[:3, 3])[:, 2]
    found, sigma = height_from_depth(given, z)
    assert given + found == pytest.approx(true, abs=sigma)


def turns(ahead, seed=0, count=60, noise=0.002):
    """Steps earlier_from_later of a turning robot as a camera so far ahead of where it is thought sees them."""
    random = np.random.default_rng(seed)
    true, thought = (camera_over_floor(*NUMBERS, 0.6, 0.5, 0.0, x) for x in (0.2 + ahead, 0.2))
    steps = np.stack([random.uniform(0, 0.2, count), np.zeros(count), random.uniform(-0.4, 0.4, count)], 1)
    measured = []
    for step in steps:
        later = random.uniform([0.8, -0.4], [1.6, 0.4], (30, 2))
        c, s = np.cos(step[2]), np.sin(step[2])
        earlier = later @ np.array([[c, s], [-s, c]]) + step[:2]
        turn, moved = kabsch(seen(true, thought, later), seen(true, thought, earlier), jnp.ones(30))
        measured.append([*np.asarray(moved), float(np.arctan2(turn[1, 0], turn[0, 0]))])
    return np.array(measured) + noise * random.standard_normal((count, 3)), steps, np.full((count, 3), noise)


@pytest.mark.parametrize("ahead", [0.05, -0.05, 0.0])
def test_turns_tell_how_far_ahead_the_camera_stands(ahead):
    found, sigma = x_from_turns(*turns(ahead, noise=0.0005))
    assert found == pytest.approx(ahead, abs=3 * sigma)
    assert 0.8 * ahead == pytest.approx(found, abs=0.2 * abs(ahead) + sigma)
    assert sigma < 0.01


def test_straight_steps_tell_nothing_of_x():
    _, counted, sigmas = turns(0.05)
    counted[:, 2] = 0
    found, sigma = x_from_turns(counted, counted, sigmas)
    assert found == 0 and sigma == pytest.approx(PRIOR_M)


def test_a_few_wrong_steps_do_not_move_x():
    measured, counted, sigmas = turns(0.05, noise=0.0005)
    plain, sigma = x_from_turns(measured, counted, sigmas)
    measured[::12, :2] += 0.3
    assert x_from_turns(measured, counted, sigmas)[0] == pytest.approx(plain, abs=2 * sigma)


def test_only_what_is_significant_is_put_right():
    kept = Reach(0.03, -0.03, 0.01, 0.01).significant()
    assert kept == Reach(0.03, -0.03, 0.01, 0.01)
    gone = Reach(0.02, -0.02, 0.01, 0.01).significant()
    assert gone == Reach(0.0, 0.0, 0.01, 0.01)
    assert Reach().significant() == Reach()
