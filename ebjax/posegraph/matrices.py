"""Poses as homogeneous matrices, and their adjoints: NumPy on the host, float64."""

import numpy as np
from jaxtyping import Float


def to_matrices(poses: Float[np.ndarray, "N P"]) -> Float[np.ndarray, "N D D"]:
    """SE(2) or SE(3) poses as homogeneous matrices."""
    poses = np.asarray(poses, float)
    if poses.shape[1] == 3:
        out = np.tile(np.eye(3), (len(poses), 1, 1))
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        out[:, 0, 0], out[:, 0, 1], out[:, 1, 0], out[:, 1, 1] = c, -s, s, c
        out[:, :2, 2] = poses[:, :2]
        return out
    out = np.tile(np.eye(4), (len(poses), 1, 1))
    w, v = poses[:, :1, None], poses[:, 1:4]
    cross = np.cross(np.eye(3)[None], v[:, None, :])
    out[:, :3, :3] = np.eye(3) + 2 * w * cross + 2 * cross @ cross
    out[:, :3, 3] = poses[:, 4:]
    return out


def from_matrices(matrices: Float[np.ndarray, "N D D"]) -> Float[np.ndarray, "N P"]:
    """Inverse of `to_matrices`; the angle is in (-pi, pi], the quaternion has w >= 0."""
    if matrices.shape[1] == 3:
        theta = np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0])
        return np.concatenate([matrices[:, :2, 2], theta[:, None]], 1)
    from scipy.spatial.transform import Rotation

    q = Rotation.from_matrix(matrices[:, :3, :3]).as_quat(canonical=True)
    return np.concatenate([q[:, [3, 0, 1, 2]], matrices[:, :3, 3]], 1)


def adjoints(matrices: Float[np.ndarray, "N D D"]) -> Float[np.ndarray, "N d d"]:
    """Ad with pose * exp(t) = exp(Ad t) * pose, tangents in the order of `ebjax.geometry.lie`."""
    turn, place = matrices[:, :-1, :-1], matrices[:, :-1, -1]
    if matrices.shape[1] == 3:
        out = np.tile(np.eye(3), (len(matrices), 1, 1))
        out[:, :2, :2], out[:, 0, 2], out[:, 1, 2] = turn, place[:, 1], -place[:, 0]
        return out
    out = np.zeros((len(matrices), 6, 6))
    out[:, :3, :3] = out[:, 3:, 3:] = turn
    out[:, :3, 3:] = np.cross(place[:, :, None], turn, axis=1)
    return out
