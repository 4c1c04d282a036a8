import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.features import verify_pairs
from ebjax.features.landmarks import Landmarks, remounted_landmarks, take
from ebjax.features.matching import Features
from ebjax.features.settle import on_floor
from ebjax.features.verify_pairs import pair_numbers, rows_of, stacked, verify_pair
from ebjax.geometry.camera import camera_over_floor, project
from ebjax.geometry.homography import apply
from ebjax.geometry.mount_numbers import mount_of
from ebjax.geometry.planar import between, chained
from ebjax.odometry.floor_steps import FloorPairs
from ebjax.odometry.motion import Keyframes, MotionConfig, fused_motion
from ebjax.odometry.mount import _solve as mount_solver
from ebjax.odometry.mount import tilted
from ebjax.odometry.wheels import WheelErrors
from ebjax.views.run_view import choose_floor, from_camera

CAMERA = camera_over_floor(400.0, 400.0, 320.0, 240.0, 640, 480, 0.6, 0.6, 0.0, 0.2)
COUNT, FEATURES, WORLD = 14, 96, 4000
SCALE = 1.04
FRAMES = 5 * np.arange(COUNT)


def drive():
    """A nearly straight drive."""
    turned = 0.02 * np.sin(np.arange(COUNT - 1))
    return chained(np.stack([np.full(COUNT - 1, 0.2), np.zeros(COUNT - 1), turned], 1))


def seen_from(camera, view, poses):
    """Landmarks of random floor points, each with a descriptor of its own, as a camera sees them from the poses."""
    random = np.random.default_rng(0)
    world = np.stack([random.uniform(0, 5, WORLD), random.uniform(-1.5, 1.5, WORLD)], 1)
    descriptors = random.standard_normal((WORLD, 32))
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    rows, keypoints, pixels = [], [], []
    for pose in poses:
        c, s = np.cos(pose[2]), np.sin(pose[2])
        base = (world - pose[:2]) @ np.array([[c, -s], [s, c]])
        at, depth = project(camera, np.concatenate([base, np.zeros((WORLD, 1))], 1))
        at = np.asarray(at) + 0.1 * random.standard_normal(at.shape)
        inside = np.asarray(apply(jnp.linalg.inv(view.image_from_view), at))
        height, width = view.size
        good = (np.asarray(depth) > 0) & (inside > 1).all(1) & (inside < [width - 2, height - 2]).all(1)
        chosen = np.flatnonzero(good & (np.arange(WORLD) % 3 == 0))[:FEATURES]
        rows.append(chosen), keypoints.append(inside[chosen]), pixels.append(at[chosen])
    least = min(map(len, rows))
    assert least > 60
    rows, keypoints, pixels = (np.stack([part[:FEATURES] for part in whole]) for whole in (rows, keypoints, pixels))
    features = Features(keypoints, descriptors[rows], np.ones(rows.shape, bool))
    floor = on_floor(jnp.asarray(pixels.reshape(-1, 2)), camera)
    none = np.zeros(rows.shape)
    points, grey = np.asarray(floor).reshape(pixels.shape), np.zeros((len(rows), *view.size), np.uint8)
    return Landmarks(features, points, np.zeros((*rows.shape, 3)), none, pixels, grey)


def pairs_of(landmarks, view):
    """What verifies rows of landmarks in pairs under any mount."""

    def pairs_under(camera, i, j):
        moved = remounted_landmarks(landmarks, camera)
        found = []
        for a, b in zip(i.tolist(), j.tolist(), strict=True):
            ends = (jax.tree.map(lambda leaf, row=row: leaf[row], moved) for row in (a, b))
            found.append(jax.tree.map(np.asarray, verify_pair(*ends, pair_numbers(0, a, b, False), view, camera, 0.02)))
        counts = np.array([(one.verified.count, one.verified.total) for one in found])
        matches = jax.tree.map(lambda *leaves: np.stack(leaves), *(one.matches for one in found))
        return FloorPairs(i, j, counts[:, 0], counts[:, 1], rows_of(matches), stacked(one.settled for one in found))

    return pairs_under


@pytest.fixture(scope="module")
def keyframes():
    """A run whose wheels count 4 % too little."""
    view, poses = from_camera(CAMERA, choose_floor(CAMERA, 0.01)), drive()
    wheels = chained(between(poses[:-1], poses[1:]) / [SCALE, SCALE, 1.0])
    views = np.random.default_rng(1).integers(0, 256, (COUNT, 16, 16, 3), np.uint8)
    landmarks = seen_from(CAMERA, view, poses)
    return Keyframes(
        frames=FRAMES,
        times=0.5 * np.arange(COUNT),
        pairs_under=pairs_of(landmarks, view),
        sample=landmarks,
        views=list(views),
        view=view,
        wheels_at=lambda offset: wheels,
        load=lambda frame: None,
        ignored=None,
    )


def moved(keyframes, camera=CAMERA, refine="tilt", **errors):
    """The motion, its largest distance from the drive in m, and the camera against the true one: degrees and m."""
    start = drive() if keyframes.wheels_at is None else keyframes.wheels_at(0.0)
    motion = fused_motion(keyframes, camera, start, MotionConfig(0.02, refine, False, WheelErrors(**errors)))
    apart = np.abs(between(drive(), motion.poses))[:, :2].max()
    mount = mount_of(np.asarray(motion.camera.base_from_camera)) - mount_of(np.asarray(CAMERA.base_from_camera))
    return motion, apart, mount * [*np.degrees(np.ones(3)), 1, 1, 1]


@pytest.mark.slow
@pytest.mark.parametrize("refine", ["tilt", "none"])
def test_the_floor_tells_the_motion_and_what_the_wheels_get_wrong(keyframes, refine):
    motion, apart, _ = moved(keyframes, refine=refine)
    assert motion.camera is CAMERA and not motion.tilt.applied
    assert apart < 0.003
    assert motion.wheels.scale == pytest.approx(SCALE, abs=0.003)
    assert motion.steps.used.all() and len(motion.steps.i) > COUNT - 1
    assert (motion.jumps, motion.carried, motion.warnings, motion.reach) == ((), 0, (), None)
    assert len(motion.chain.i) == COUNT - 1 and motion.covariance.shape == (COUNT - 1, 3, 3)
    np.testing.assert_array_equal(motion.frames, FRAMES)


@pytest.mark.slow
def test_the_floor_alone_tells_the_motion(keyframes):
    motion, apart, _ = moved(dataclasses.replace(keyframes, wheels_at=None))
    assert apart < 0.003
    assert motion.wheels is None and motion.carried == 0


def test_a_jump_of_the_wheels_is_found(keyframes):
    wheels = keyframes.wheels_at(0.0).copy()
    wheels[7:, 0] += 0.6
    motion, apart, _ = moved(dataclasses.replace(keyframes, wheels_at=lambda offset: wheels))
    assert apart < 0.003
    (jump,) = motion.jumps
    assert (jump.frame, jump.seconds) == (FRAMES[7], 0.5)
    assert jump.metres == pytest.approx(0.8, abs=0.02)


def test_a_gap_is_bridged_by_the_wheels(keyframes):
    features = keyframes.sample.features
    blind = dataclasses.replace(features, valid=features.valid & (np.arange(COUNT) != 6)[:, None])
    landmarks = dataclasses.replace(keyframes.sample, features=blind)
    without = dataclasses.replace(keyframes, sample=landmarks, pairs_under=pairs_of(landmarks, keyframes.view))
    motion, apart, _ = moved(without)
    assert apart < 0.01
    assert not np.isin(6, [*motion.steps.i[motion.steps.used], *motion.steps.j[motion.steps.used]])
    assert motion.carried == 0


def test_a_wrong_tilt_is_put_right_unless_it_is_to_be_left(keyframes):
    given = tilted(CAMERA, jnp.radians(jnp.array([0.7, 0.0])))
    motion, apart, mount = moved(keyframes, given)
    assert motion.tilt.applied and motion.tilt.pitch_deg == pytest.approx(-0.7, abs=0.03)
    assert np.abs(mount[:2]).max() < 0.05 and apart < 0.01
    left, _, _ = moved(keyframes, given, "none")
    assert left.camera is given and not left.tilt.applied


def test_good_wheels_put_the_height_right(keyframes):
    true = drive()
    exact = dataclasses.replace(keyframes, wheels_at=lambda offset: true)
    pose = jnp.asarray(CAMERA.base_from_camera).at[2, 3].add(-0.02)
    given = dataclasses.replace(CAMERA, base_from_camera=pose)
    motion, _, mount = moved(exact, given, "all", scale_sigma=0.001)
    assert motion.reach.height_m == pytest.approx(0.02, abs=0.003)
    assert abs(mount[3]) < 0.003
    motion, _, mount = moved(exact, given)
    assert motion.reach is None and mount[3] == pytest.approx(-0.02)


def test_another_run_compiles_nothing(keyframes):
    programs = (verify_pairs.verify_pair, verify_pairs._settle, mount_solver)
    moved(keyframes)
    before = [program._cache_size() for program in programs]
    moved(keyframes, tilted(CAMERA, jnp.radians(jnp.array([0.7, 0.2]))))
    few = dataclasses.replace(
        keyframes,
        **{name: getattr(keyframes, name)[:-1] for name in ("frames", "times", "views")},
        sample=take(keyframes.sample, np.arange(COUNT - 1)),
        wheels_at=lambda offset: keyframes.wheels_at(offset)[:-1],
    )
    fused_motion(few, CAMERA, few.wheels_at(0.0), MotionConfig(0.02, "tilt", False, WheelErrors()))
    assert [program._cache_size() for program in programs] == before
    # Settling apart from verifying is what other mounts ask for.
    assert before[0] >= 1 and before[2] >= 1
