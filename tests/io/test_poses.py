import numpy as np
import pytest
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from ebjax.io.poses import (
    interpolate,
    invert,
    poses_from,
    quaternion_from_angles,
    quaternion_from_rotation,
    rigid_fault,
    rotation_from_quaternion,
)


def rotations(count=200, seed=0):
    rng = np.random.default_rng(seed)
    vectors = rng.normal(size=(count, 3))
    angles = np.concatenate([[0.0, 1e-12, 1e-7, np.pi, np.pi - 1e-9], rng.uniform(0, np.pi, count - 5)])
    return Rotation.from_rotvec(vectors / np.linalg.norm(vectors, axis=1, keepdims=True) * angles[:, None])


def test_quaternions_agree_with_scipy_at_every_angle():
    truth = rotations()
    quaternion = quaternion_from_rotation(truth.as_matrix())
    expected = truth.as_quat(scalar_first=True)
    assert np.abs(np.abs(np.sum(quaternion * expected, axis=1)) - 1).max() < 1e-14
    np.testing.assert_allclose(rotation_from_quaternion(quaternion * 1.7), truth.as_matrix(), atol=1e-14)


def test_angles_agree_with_scipy():
    angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (50, 3))
    expected = Rotation.from_euler("ZYX", angles[:, ::-1]).as_quat(scalar_first=True)
    found = quaternion_from_angles(angles)
    np.testing.assert_allclose(np.abs((found * expected).sum(axis=1)), 1, atol=1e-14)


def test_invert_is_the_inverse():
    poses = poses_from(rotations().as_matrix(), np.random.default_rng(1).normal(size=(200, 3)))
    np.testing.assert_allclose(invert(poses) @ poses, np.tile(np.eye(4), (200, 1, 1)), atol=1e-13)


def test_interpolation_is_the_matrix_exponential_of_the_twist():
    rng = np.random.default_rng(2)
    start = poses_from(rotations(20, 3).as_matrix(), rng.normal(size=(20, 3)))
    turn = Rotation.from_rotvec(
        rng.uniform(-1, 1, (20, 3)) * np.array([0.0, 1e-9, 1e-3, 1.0, 1.5])[np.arange(20) % 5, None]
    )
    end = start @ poses_from(turn.as_matrix(), rng.normal(size=(20, 3)))
    share = rng.uniform(size=20)
    share[:2] = 0, 1
    between = interpolate(start, end, share)
    for k in range(20):
        expected = start[k] @ expm(share[k] * np.real(logm(np.linalg.inv(start[k]) @ end[k])))
        np.testing.assert_allclose(between[k], expected, atol=1e-7)


def test_interpolation_follows_the_arc_a_robot_drives():
    angles = np.array([0.0, 0.8])
    circle = poses_from(
        Rotation.from_rotvec(np.array([[0, 0, a] for a in angles])).as_matrix(),
        np.stack([np.sin(angles), 1 - np.cos(angles), 0 * angles], axis=1),
    )
    middle = interpolate(circle[:1], circle[1:], np.array([0.5]))[0]
    np.testing.assert_allclose(middle[:3, 3], [np.sin(0.4), 1 - np.cos(0.4), 0], atol=1e-12)


@pytest.mark.parametrize(
    "change, words", [((3, 0, 1.0), "last row"), ((0, 0, 1.1), "not a rotation"), ((0, 0, -1.0), "reflection")]
)
def test_faults_are_named(change, words):
    pose = np.eye(4)
    assert rigid_fault(pose) == ""
    pose[change[0], change[1]] = change[2]
    assert words in rigid_fault(pose)
