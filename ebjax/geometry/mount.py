"""How a camera is mounted on a robot, in six numbers: pitch, roll, yaw (rad), height, x, y (m).

base_from_camera = Rz(yaw) [camera_over_floor(pitch, roll)], its optical centre at (x, y, height) in base: pitch is the
downward tilt of the optical axis, roll the turn about it, yaw the turn of both to the left. Looking straight down, roll
and yaw are the same turn.
"""

import dataclasses
import typing

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ebjax.geometry.camera import Camera
from ebjax.geometry.homography import Arrays

NAMES = ("pitch", "roll", "yaw", "height", "x", "y")
Mount = Float[Arrays, "6"]


def mount_of(base_from_camera: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "6"]:
    """The six numbers of a camera's pose on the robot; the inverse of `base_from_mounted_camera`."""
    rotation, (x, y, height) = base_from_camera[:3, :3], base_from_camera[:3, 3]
    ahead = rotation[:, 2]
    pitch = np.arctan2(-ahead[2], np.hypot(ahead[0], ahead[1]))
    roll, yaw = np.arctan2(-rotation[2, 0], -rotation[2, 1]), np.arctan2(ahead[1], ahead[0])
    return np.array([pitch, roll, yaw, height, x, y])


@jax.jit
def base_from_mounted_camera(mount: Mount) -> Float[Array, "4 4"]:
    """The pose on the robot of a camera mounted like this; differentiable."""
    pitch, roll, yaw, height, x, y = jnp.asarray(mount)
    (s, c), (sr, cr), (sy, cy) = ((jnp.sin(a), jnp.cos(a)) for a in (pitch, roll, yaw))
    zero, one = jnp.zeros_like(s), jnp.ones_like(s)
    tilted = jnp.stack([jnp.stack(row) for row in ([-s * sr, -s * cr, c], [-cr, sr, zero], [-c * sr, -c * cr, -s])])
    turned = jnp.stack([jnp.stack(row) for row in ([cy, -sy, zero], [sy, cy, zero], [zero, zero, one])])
    top = jnp.concatenate([turned @ tilted, jnp.stack([x, y, height])[:, None]], axis=1)
    return jnp.concatenate([top, jnp.stack([zero, zero, zero, one])[None, :]])


# Unchecked at run time: vmap and optimisers rebuild the node with other leaves.
@typing.no_type_check
@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Mounting:
    """What is added to a camera's pitch and roll, rad, and to its height above the floor, m."""

    pitch_rad: Float[Array, ""]
    roll_rad: Float[Array, ""]
    height_m: Float[Array, ""]


def remounted(camera: Camera, mounting: Mounting) -> Camera:
    """R' = R_y(pitch) R R_z(roll), z' = z + height; differentiable in the mounting.

    A camera that looks straight ahead over pitch p, roll r and height h (`camera_over_floor`) becomes the one over
    p + pitch, r + roll and h + height: pitch tilts down about base's y axis, roll turns about the optical axis.
    """
    pose = jnp.asarray(camera.base_from_camera)
    pitch, roll, height = (
        jnp.asarray(v, pose.dtype) for v in (mounting.pitch_rad, mounting.roll_rad, mounting.height_m)
    )
    s, c, sr, cr = jnp.sin(pitch), jnp.cos(pitch), jnp.sin(roll), jnp.cos(roll)
    zero, one = jnp.zeros_like(s), jnp.ones_like(s)
    tilt = jnp.stack([jnp.stack([c, zero, s]), jnp.stack([zero, one, zero]), jnp.stack([-s, zero, c])])
    turn = jnp.stack([jnp.stack([cr, -sr, zero]), jnp.stack([sr, cr, zero]), jnp.stack([zero, zero, one])])
    pose = pose.at[:3, :3].set(tilt @ pose[:3, :3] @ turn)
    return dataclasses.replace(camera, base_from_camera=pose.at[2, 3].add(height))
