"""How a camera is mounted, as three small corrections: what a calibration of the floor homography tunes."""

import dataclasses
import typing

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ebjax.geometry.camera import Camera


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
