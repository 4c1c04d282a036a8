import dataclasses
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.features.settle import PairMatches, on_floor
from ebjax.features.verify_pairs import rows_of
from ebjax.geometry.camera import camera_over_floor, project
from ebjax.geometry.mount_numbers import mount_of
from ebjax.geometry.planar import compose, inverse
from ebjax.geometry.rigid import kabsch
from ebjax.odometry.mount import FEWEST, PRIOR_DEG, Tilt, refine_tilt, tilted

NUMBERS = (400.0, 400.0, 320.0, 240.0, 640, 480)
TOLERANCE_M = 0.02
TRUE = camera_over_floor(*NUMBERS, 0.6, 0.6, 0.0, 0.2)
MATCHES = 64


def placed(pose, points):
    """Points in another frame."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return points @ np.array([[c, s], [-s, c]]) + pose[:2]


def look(pose, points):
    """The pixels of points of the world, and which are seen well."""
    local = placed(inverse(pose), points)
    pixels, depth = project(TRUE, np.concatenate([local, np.zeros((len(points), 1))], 1))
    pixels = np.asarray(pixels)
    inside = (np.asarray(depth) > 0) & (pixels >= 0).all(1) & (pixels <= [639, 479]).all(1)
    return pixels, inside & (np.hypot(*local.T) < 2.2)


@cache
def pixels_of_pairs(count, seed):
    """Pixels that both ends of some pairs see: every other pair looks in opposite directions."""
    random = np.random.default_rng(seed)
    pairs = []
    for k in range(count):
        j = np.array([*random.uniform(-5, 5, 2), random.uniform(-np.pi, np.pi)])
        off = [random.uniform(0.2, 0.8), *random.uniform(-0.1, 0.1, 2)]
        if k % 2:
            off = [2 * random.uniform(0.9, 1.2), random.uniform(-0.2, 0.2), np.pi + random.uniform(-0.2, 0.2)]
        i = compose(j, np.array(off))
        points = placed(j, random.uniform([0.2, -1], [2.2, 1], (4000, 2)))
        (a, seen_a), (b, seen_b) = (look(pose, points) for pose in (i, j))
        rows = np.flatnonzero(seen_a & seen_b)[:MATCHES]
        assert len(rows) == MATCHES
        a, b = (pixels[rows] + 0.2 * random.standard_normal((MATCHES, 2)) for pixels in (a, b))
        wrong = random.random(MATCHES) < 0.05
        a[wrong] = random.uniform([0, 120], [639, 479], (wrong.sum(), 2))
        pairs.append((a, b, ~wrong))
    return pairs


def pairs_under(camera, count=40, seed=0):
    """Pairs with starts as matches under that camera give them."""
    pairs = pixels_of_pairs(count, seed)
    starts = []
    for a, b, right in pairs:
        ours, theirs = (on_floor(jnp.asarray(pixels), camera) for pixels in (a, b))
        turn, moved = kabsch(theirs, ours, jnp.asarray(right, float))
        starts.append([*np.asarray(moved), float(np.arctan2(turn[1, 0], turn[0, 0]))])
    a, b = (np.stack([pair[k] for pair in pairs]) for k in (0, 1))
    none, alike = np.zeros((count, MATCHES, 3)), np.tile(np.eye(2), (count, MATCHES, 1, 1))
    return PairMatches(a, b, none, none, np.ones((count, MATCHES), bool), np.array(starts), alike)


def off_deg(camera):
    """Pitch and roll of a camera against the true one, degrees."""
    return np.degrees(mount_of(np.asarray(camera.base_from_camera)) - mount_of(np.asarray(TRUE.base_from_camera)))[:2]


@pytest.mark.parametrize("wrong", [(0.5, 0.0), (-1.0, 0.0), (0.0, 0.5), (0.0, -1.0), (0.5, 0.5)])
def test_a_wrong_tilt_comes_back(wrong):
    given = tilted(TRUE, jnp.radians(jnp.array(wrong)))
    np.testing.assert_allclose(off_deg(given), wrong, atol=1e-9)
    camera, found = refine_tilt(rows_of(pairs_under(given)), np.ones(40, bool), given, TOLERANCE_M)
    assert found.applied and found.pairs == 40
    np.testing.assert_allclose(off_deg(camera), 0, atol=0.02)
    np.testing.assert_allclose([found.pitch_deg, found.roll_deg], -np.array(wrong), atol=0.02)
    sigma = np.array([found.pitch_sigma_deg, found.roll_sigma_deg])
    assert (np.abs(off_deg(camera)) < 2.5 * sigma).all() and (sigma < 0.1).all()


@pytest.mark.parametrize("opposing", [False, True])
def test_pairs_of_one_direction_tell_it_too(opposing):
    given = tilted(TRUE, jnp.radians(jnp.array([0.5, -0.5])))
    camera, found = refine_tilt(rows_of(pairs_under(given, 60)), np.arange(60) % 2 == opposing, given, TOLERANCE_M)
    assert found.applied and found.pairs == 30
    sigma = np.array([found.pitch_sigma_deg, found.roll_sigma_deg])
    assert (np.abs(off_deg(camera)) < np.minimum(2.5 * sigma, 0.02)).all()


def test_height_and_place_are_left_alone():
    given = tilted(TRUE, jnp.radians(jnp.array([0.5, 0.3])))
    camera, _ = refine_tilt(rows_of(pairs_under(given)), np.ones(40, bool), given, TOLERANCE_M)
    np.testing.assert_allclose(camera.base_from_camera[:, 3], TRUE.base_from_camera[:, 3], atol=1e-12)
    np.testing.assert_array_equal(camera.intrinsics, TRUE.intrinsics)


@pytest.mark.parametrize("seed", range(4))
def test_an_exact_camera_stays_the_very_same(seed):
    camera, found = refine_tilt(rows_of(pairs_under(TRUE, seed=seed)), np.ones(40, bool), TRUE, TOLERANCE_M)
    assert camera is TRUE and not found.applied
    assert abs(found.pitch_deg) < 2.5 * found.pitch_sigma_deg
    assert abs(found.roll_deg) < 2.5 * found.roll_sigma_deg


def test_only_the_pairs_in_use_count():
    given = tilted(TRUE, jnp.radians(jnp.array([0.5, 0.0])))
    matches = pairs_under(given)
    used = np.arange(40) % 4 != 1
    spoilt = np.asarray(matches.pixels_i).copy()
    spoilt[~used] = np.random.default_rng(0).uniform(150, 450, spoilt[~used].shape)
    camera, found = refine_tilt(rows_of(dataclasses.replace(matches, pixels_i=spoilt)), used, given, TOLERANCE_M)
    assert found.pairs == 30 and found.applied
    np.testing.assert_allclose(off_deg(camera), 0, atol=0.02)


def test_few_pairs_change_nothing():
    given = tilted(TRUE, jnp.radians(jnp.array([1.0, 0.0])))
    camera, found = refine_tilt(rows_of(pairs_under(given)), np.arange(40) < FEWEST - 1, given, TOLERANCE_M)
    assert camera is given
    assert found == Tilt(pairs=FEWEST - 1)
    assert found.pitch_sigma_deg == PRIOR_DEG


def test_many_pairs_are_thinned_out():
    matches = pairs_under(TRUE)
    many = jax.tree.map(lambda leaf: np.concatenate([leaf] * 8), matches)
    _, found = refine_tilt(rows_of(many), np.ones(320, bool), TRUE, TOLERANCE_M)
    assert found.pairs == 256


def test_tilts_add_up_where_they_were_put_right():
    first, more = Tilt(0.5, -0.2, 0.1, 0.1, 20, True), Tilt(0.1, 0.1, 0.05, 0.04, 30, False)
    assert first.further(more) == Tilt(0.5 + 0.1, -0.2 + 0.1, 0.05, 0.04, 30, True)
    assert dataclasses.replace(first, applied=False).further(more) == more
