"""Steps over which the ground bends."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from ebjax.features.settle import PairMatches
from ebjax.features.verify_pairs import rows_of
from ebjax.geometry.camera import camera_over_floor, project
from ebjax.odometry.floor_steps import FloorPairs
from ebjax.odometry.ground import bends, ground_warnings

CAMERA = camera_over_floor(380.0, 380.0, 319.5, 239.5, 640, 480, 0.54, np.radians(19), 0.01, 0.27)
COUNT = 150
POSES = np.array([[0.0, 0, 0], [0.25, 0.01, 0.02], [0.5, 0.02, 0.04], [0.75, 0.02, 0.04]])


def nodding(degrees):
    """The camera of a robot that stands with its nose up by so much."""
    c, s = np.cos(np.radians(-degrees)), np.sin(np.radians(-degrees))
    pose = np.array(CAMERA.base_from_camera)
    pose[:3] = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ pose[:3]
    return dataclasses.replace(CAMERA, base_from_camera=jnp.asarray(pose))


def pairs(pitches, right=0.35):
    """Successive steps; a share of the matches is right, and all of those agree where neither view is pitched."""
    random = np.random.default_rng(0)
    found, inliers = [], []
    for k in (1, 2, 3):
        world = random.uniform([1.2, -0.6], [2.6, 0.6], (COUNT, 2)) + POSES[k, :2]
        pixels = []
        for pose, pitch in ((POSES[k], pitches[k]), (POSES[k - 1], pitches[k - 1])):
            c, s = np.cos(pose[2]), np.sin(pose[2])
            base = (world - pose[:2]) @ np.array([[c, -s], [s, c]])
            at, _ = project(nodding(pitch), jnp.asarray(np.c_[base, np.zeros(COUNT)]))
            pixels.append(np.asarray(at) + 0.2 * random.standard_normal(at.shape))
        wrong = np.arange(COUNT) > right * COUNT
        pixels[0][wrong] = random.permutation(pixels[0][wrong])
        none, all_ = np.zeros((COUNT, 3)), np.ones(COUNT, bool)
        found.append(PairMatches(*pixels, none, none, all_, np.zeros(3), np.tile(np.eye(2), (COUNT, 1, 1))))
        inliers.append(4 if pitches[k] != pitches[k - 1] else int(right * COUNT))
    matches = PairMatches(*(np.stack([getattr(m, f.name) for m in found]) for f in dataclasses.fields(PairMatches)))
    return FloorPairs(np.array([1, 2, 3]), np.array([0, 1, 2]), np.array(inliers), np.full(3, COUNT), rows_of(matches))


def test_both_ends_of_a_ramp_are_found_and_named():
    found = bends(pairs([0.0, 5.0, 5.0, 0.0]), POSES, CAMERA, 0.02)
    assert [b.row for b in found] == [1, 3]
    assert all(abs(b.degrees - 5) <= 1 for b in found)
    (line,) = ground_warnings(found, np.arange(4) + 10.5, POSES)
    assert "degrees at 11.500 s (x 0.2, y 0.0 m)" in line and "degrees at 13.500 s (x 0.8" in line


def test_a_flat_floor_has_none_and_neither_has_a_step_of_wrong_matches():
    assert bends(pairs([0.0] * 4), POSES, CAMERA, 0.02) == []
    level = pairs([0.0] * 4, right=0.0)
    assert bends(dataclasses.replace(level, inliers=np.array([3, 3, 3])), POSES, CAMERA, 0.02) == []
    assert ground_warnings([], np.arange(4.0), POSES) == ()


def test_many_places_are_counted():
    found = bends(pairs([0.0, 5.0, 0.0, 5.0]), POSES, CAMERA, 0.02)
    assert len(found) == 3
    (line,) = ground_warnings(found * 2, np.arange(4.0), POSES)
    assert "and at 2 more steps" in line
