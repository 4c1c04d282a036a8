"""Rigid transforms on the host, NumPy float64: quaternions, constant-twist interpolation, checks.

Quaternions are wxyz here; TUM and g2o files hold xyzw and convert at the file.
"""

import numpy as np
from jaxtyping import Float


def rotation_from_quaternion(quaternion: Float[np.ndarray, "N 4"]) -> Float[np.ndarray, "N 3 3"]:
    """Turns quaternions (wxyz, any positive length) into rotation matrices."""
    w, x, y, z = np.moveaxis(quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True), 1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_from_rotation(rotation: Float[np.ndarray, "N 3 3"]) -> Float[np.ndarray, "N 4"]:
    """Turns rotation matrices into unit quaternions wxyz with w >= 0.

    The matrix 4 q q^T is linear in R; the column with the largest diagonal entry is divided by its root, which is
    stable at every angle, pi included.
    """
    r = rotation
    trace = np.trace(r, axis1=1, axis2=2)
    outer = np.empty((len(r), 4, 4), dtype=r.dtype)
    outer[:, 0, 0] = 1 + trace
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        outer[:, 0, i + 1] = outer[:, i + 1, 0] = r[:, k, j] - r[:, j, k]
        outer[:, i + 1, i + 1] = 1 + 2 * r[:, i, i] - trace
        outer[:, i + 1, j + 1] = outer[:, j + 1, i + 1] = r[:, i, j] + r[:, j, i]
    largest = np.argmax(np.diagonal(outer, axis1=1, axis2=2), axis=1)
    quaternion = outer[np.arange(len(r)), largest]
    quaternion = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    return np.where(quaternion[:, :1] < 0, -quaternion, quaternion)


def quaternion_from_angles(roll_pitch_yaw: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 4"]:
    """Returns the quaternions (wxyz) of Rz(yaw) Ry(pitch) Rx(roll), rad."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(roll_pitch_yaw / 2).T, np.sin(roll_pitch_yaw / 2).T
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=1,
    )


def poses_from(
    rotation: Float[np.ndarray, "N 3 3"], translation: Float[np.ndarray, "N 3"]
) -> Float[np.ndarray, "N 4 4"]:
    """Stacks rotations and translations into 4x4 transforms."""
    poses = np.tile(np.eye(4), (len(rotation), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = rotation, translation
    return poses


def invert(poses: Float[np.ndarray, "N 4 4"]) -> Float[np.ndarray, "N 4 4"]:
    """Inverts rigid transforms: (R, t) -> (R^T, -R^T t)."""
    transposed = np.swapaxes(poses[:, :3, :3], 1, 2)
    return poses_from(transposed, -np.einsum("nij,nj->ni", transposed, poses[:, :3, 3]))


def _skew(vectors: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3 3"]:
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)


def interpolate(
    start: Float[np.ndarray, "N 4 4"], end: Float[np.ndarray, "N 4 4"], share: Float[np.ndarray, " N"]
) -> Float[np.ndarray, "N 4 4"]:
    """Moves along SE(3) at a constant twist: start exp(share log(start^-1 end)).

    A wheeled robot drives arcs, and the arc is this curve; straight-line interpolation cuts the corner.

    Args:
      start: the pose at share 0.
      end: the pose at share 1; less than half a turn from `start`.
      share: where between the two, in [0, 1].
    """
    end_in_start = invert(start) @ end
    quaternion = quaternion_from_rotation(end_in_start[:, :3, :3])
    sine = np.linalg.norm(quaternion[:, 1:], axis=1)
    angle = 2 * np.arctan2(sine, quaternion[:, 0])
    axis = quaternion[:, 1:] / np.where(sine > 0, sine, 1.0)[:, None]
    turn, turn_squared = _skew(axis), _skew(axis) @ _skew(axis)

    def left_jacobian(theta: np.ndarray) -> np.ndarray:
        small = np.abs(theta) < 1e-6
        safe = np.where(small, 1.0, theta)
        first = np.where(small, theta / 2, (1 - np.cos(safe)) / safe)[:, None, None]
        second = np.where(small, theta**2 / 6, 1 - np.sin(safe) / safe)[:, None, None]
        return np.eye(3)[None] + first * turn + second * turn_squared

    theta = share * angle
    rotation = np.eye(3)[None] + np.sin(theta)[:, None, None] * turn + (1 - np.cos(theta))[:, None, None] * turn_squared
    velocity = np.linalg.solve(left_jacobian(angle), end_in_start[:, :3, 3:])
    translation = share[:, None] * (left_jacobian(theta) @ velocity)[..., 0]
    return start @ poses_from(rotation, translation)


def rigid_fault(pose: Float[np.ndarray, "4 4"], tolerance: float = 1e-3) -> str:
    """Says what keeps a 4x4 matrix from being a rigid transform, or "" when nothing does."""
    rotation = pose[:3, :3]
    if not np.allclose(pose[3], [0, 0, 0, 1], rtol=0, atol=1e-9):
        return "its last row is not 0 0 0 1"
    if not np.abs(rotation).max() < 2 or np.abs(rotation @ rotation.T - np.eye(3)).max() > tolerance:
        return "its 3x3 part is not a rotation (rows must be orthonormal)"
    return "its 3x3 part is a reflection (determinant -1)" if np.linalg.det(rotation) < 0 else ""
