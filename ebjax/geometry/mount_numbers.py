"""How a camera is mounted on a robot, in six numbers: pitch, roll, yaw (rad), height, x, y (m). Loads no JAX.

base_from_camera = Rz(yaw) [camera_over_floor(pitch, roll)], its optical centre at (x, y, height) in base: pitch is the
downward tilt of the optical axis, roll the turn about it, yaw the turn of both to the left. Looking straight down, roll
and yaw are the same turn.
"""

import numpy as np
from jaxtyping import Float

NAMES = ("pitch", "roll", "yaw", "height", "x", "y")


def mount_of(base_from_camera: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "6"]:
    """The six numbers of a camera's pose on the robot; the inverse of `pose_of`."""
    rotation, (x, y, height) = base_from_camera[:3, :3], base_from_camera[:3, 3]
    ahead = rotation[:, 2]
    pitch = np.arctan2(-ahead[2], np.hypot(ahead[0], ahead[1]))
    roll, yaw = np.arctan2(-rotation[2, 0], -rotation[2, 1]), np.arctan2(ahead[1], ahead[0])
    return np.array([pitch, roll, yaw, height, x, y])


def pose_of(mount: Float[np.ndarray, "6"]) -> Float[np.ndarray, "4 4"]:
    """The pose on the robot of a camera mounted like this; `mount.base_from_mounted_camera` without gradients."""
    pitch, roll, yaw, height, x, y = mount
    (s, c), (sr, cr), (sy, cy) = ((np.sin(a), np.cos(a)) for a in (pitch, roll, yaw))
    tilted = np.array([[-s * sr, -s * cr, c], [-cr, sr, 0.0], [-c * sr, -c * cr, -s]])
    turned = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turned @ tilted, (x, y, height)
    return pose


def pose_of_homography(
    intrinsics: Float[np.ndarray, "3 3"], floor_from_image: Float[np.ndarray, "3 3"]
) -> tuple[Float[np.ndarray, "4 4"], float]:
    """The pose on the robot of a pinhole that sees the floor by a homography: K [r1 r2 t] = its inverse.

    Args:
      intrinsics: K, px, of the homography's pixels.
      floor_from_image: pixels -> the floor z = 0 of base, m; of any scale and sign.

    Returns:
      base_from_camera, and by which share [r1 r2] differ from two unit vectors at right angles: 0 for a rigid mount.
    """
    seen = np.linalg.inv(intrinsics) @ np.linalg.inv(floor_from_image)
    seen = seen / np.sqrt(np.linalg.norm(seen[:, 0]) * np.linalg.norm(seen[:, 1]))
    rotation = np.column_stack([seen[:, :2], np.cross(seen[:, 0], seen[:, 1])])
    if -(rotation[:, 2] @ seen[:, 2]) < 0:  # below the floor: the other sign
        seen, rotation = -seen, rotation * np.array([-1.0, -1.0, 1.0])
    left, stretch, right = np.linalg.svd(rotation)
    pose = np.eye(4)
    pose[:3, :3] = (left @ right).T
    pose[:3, 3] = -pose[:3, :3] @ seen[:, 2]
    return pose, float(np.abs(stretch - 1).max())
