import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.features.settle import PairMatches, on_floor
from ebjax.geometry.camera import camera_over_floor, image_from_floor
from ebjax.geometry.homography import apply
from ebjax.geometry.mount_numbers import mount_of
from ebjax.geometry.planar import between
from ebjax.odometry.nods import leant, levelled_matches, nods, within

CAMERA = camera_over_floor(600.0, 600.0, 320.0, 240.0, 640, 480, 0.6, np.radians(25), 0.0, 0.2)
COUNT, MATCHES = 24, 120


def driven(random):
    """Poses on a gentle bend, keyframes a quarter of a metre and half a second apart."""
    heading = np.cumsum(random.normal(0, 0.02, COUNT))
    step = 0.25 * np.stack([np.cos(heading), np.sin(heading)], 1)
    return np.concatenate([np.cumsum(step, 0), heading[:, None]], 1)


def nodding(random, degrees):
    times = 0.5 * np.arange(COUNT)[:, None, None]
    waves = np.sin(2 * np.pi * np.array([0.37, 0.73]) * times + random.uniform(0, 6, (2, 2)))
    return np.radians(degrees) * (np.array([0.8, 0.6]) * waves).sum(-1)


def seen(points, lean):
    """Pixels of floor points in the image of a robot that leans."""
    return np.asarray(apply(image_from_floor(leant(CAMERA, jnp.asarray(lean))), points))


def matched(random, poses, lean, i, j, noise_px=0.2):
    rows_i, rows_j = [], []
    for a, b in zip(i, j, strict=True):
        x, y, turn = between(poses[a][None], poses[b][None])[0]
        there = np.stack([random.uniform(0.9, 2.4, MATCHES), random.uniform(-0.7, 0.7, MATCHES)], 1)
        c, s = np.cos(turn), np.sin(turn)
        here = there @ np.array([[c, s], [-s, c]]) + [x, y]
        rows_i.append(seen(here, lean[a]) + noise_px * random.normal(size=here.shape))
        rows_j.append(seen(there, lean[b]))
    pixels_i, pixels_j = np.array(rows_i), np.array(rows_j)
    starts = between(poses[i], poses[j]) + random.normal(0, 0.03, (len(i), 3))
    none = np.zeros((*pixels_i.shape[:2], 3))
    spread = np.broadcast_to(0.04 * np.eye(2), (*pixels_i.shape[:2], 2, 2))
    return PairMatches(pixels_i, pixels_j, none, none, np.ones(pixels_i.shape[:2], bool), starts, spread)


def pairs():
    i = np.concatenate([np.arange(gap, COUNT) for gap in (1, 2, 4)])
    return i, np.concatenate([np.arange(COUNT - gap) for gap in (1, 2, 4)])


@pytest.fixture
def run():
    random = np.random.default_rng(0)
    poses, lean = driven(random), nodding(random, 1.0)
    i, j = pairs()
    return random, poses, lean, i, j, matched(random, poses, lean, i, j)


def test_nods_are_found(run):
    _, poses, lean, i, j, matches = run
    times = 0.5 * np.arange(COUNT)
    found = nods(matches, i, j, COUNT, CAMERA, times=times)
    assert np.degrees(np.sqrt(np.mean(lean**2))) > 0.6
    assert np.degrees(np.sqrt(np.mean((found.lean - lean) ** 2))) < 0.08
    wheels = between(poses[i], poses[j]), np.full((len(i), 3), 0.004)
    steady = nods(matches, i, j, COUNT, CAMERA, times=times, wheels=wheels)
    assert np.degrees(np.sqrt(np.mean((steady.lean - lean) ** 2))) < 0.06
    level = found.level_from_base(2 * np.arange(COUNT), 2 * COUNT)
    np.testing.assert_array_equal(level[1], np.eye(4))
    leaning = dataclasses.replace(CAMERA, base_from_camera=level[2] @ np.asarray(CAMERA.base_from_camera))
    expected = leant(CAMERA, jnp.asarray(found.lean[1])).base_from_camera
    np.testing.assert_allclose(leaning.base_from_camera, expected, atol=1e-12)


def test_wrong_pairs_do_not_bend_the_others(run):
    _, _, lean, i, j, matches = run
    wrong = np.array(matches.pixels_i)
    wrong[:3] += np.array([30.0, 5.0]) + 0.15 * (wrong[:3] - 300)
    broken = dataclasses.replace(matches, pixels_i=wrong)
    found = nods(broken, i, j, COUNT, CAMERA, times=0.5 * np.arange(COUNT))
    assert np.degrees(np.sqrt(np.mean((found.lean[6:] - lean[6:]) ** 2))) < 0.1


def test_a_robot_that_stands_upright_does_not_nod(run):
    random, poses, _, i, j, _ = run
    still = matched(random, poses, np.zeros((COUNT, 2)), i, j)
    found = nods(still, i, j, COUNT, CAMERA, times=0.5 * np.arange(COUNT))
    assert np.degrees(np.abs(found.lean).max()) < 0.1


def test_levelled_matches_are_those_of_a_level_camera(run):
    random, poses, lean, i, j, _ = run
    exact = matched(random, poses, lean, i, j, noise_px=0.0)
    found = nods(exact, i, j, COUNT, CAMERA)
    level = levelled_matches(exact, i, j, dataclasses.replace(found, lean=lean), CAMERA)
    motion = between(poses[i], poses[j])
    for k in (0, 30, 60):
        here, there = (
            np.asarray(on_floor(jnp.asarray(pixels[k]), CAMERA)) for pixels in (level.pixels_i, level.pixels_j)
        )
        c, s = np.cos(motion[k, 2]), np.sin(motion[k, 2])
        np.testing.assert_allclose(here, there @ np.array([[c, s], [-s, c]]) + motion[k, :2], atol=1e-9)
    assert np.asarray(within(dataclasses.replace(level, start=motion), CAMERA, 1e-6)).all()
    assert not np.asarray(within(dataclasses.replace(exact, start=motion), CAMERA, 1e-3)).all()


def test_points_by_depth_lean_too(run):
    _, _, lean, i, j, matches = run
    point = np.tile([0.1, 0.2, 1.5], (*matches.points_i.shape[:2], 1))
    deep = dataclasses.replace(matches, points_i=point)
    found = nods(matches, i, j, COUNT, CAMERA)
    level = levelled_matches(deep, i, j, dataclasses.replace(found, lean=lean), CAMERA)
    pose = np.asarray(CAMERA.base_from_camera)
    leaning = np.asarray(leant(CAMERA, jnp.asarray(lean[i[5]])).base_from_camera)
    here = pose[:3, :3] @ np.asarray(level.points_i)[5, 0] + pose[:3, 3]
    np.testing.assert_allclose(here, leaning[:3, :3] @ point[5, 0] + leaning[:3, 3], atol=1e-12)
    assert (np.asarray(level.points_j) == 0).all()


@pytest.mark.slow
def test_pitch_and_roll_are_the_mounts():
    """Pitch is nose down as the camera's is; roll lowers the right side, which turns the image the other way."""
    lean = np.radians([2.0, 0.0])
    change = mount_of(np.asarray(leant(CAMERA, jnp.asarray(lean)).base_from_camera)) - mount_of(
        np.asarray(CAMERA.base_from_camera)
    )
    assert change[0] == pytest.approx(lean[0], abs=1e-9)
