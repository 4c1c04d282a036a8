"""A camera's mount on a robot, differentiable: its pose from the six numbers of `mount_numbers`, and changes of it."""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ebjax.geometry.camera import Camera
from ebjax.geometry.homography import Arrays
from ebjax.geometry.pytree import pytree

Mount = Float[Arrays, "6"]


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


@pytree
class Mounting:
    """What is added to a camera's pitch and roll, rad, and to its height above the floor, m."""

    pitch_rad: Float[Array, ""]
    roll_rad: Float[Array, ""]
    height_m: Float[Array, ""]


def remounted(camera: Camera, mounting: Mounting) -> Camera:
    """R' = R_z(yaw) R_y(pitch) R_z(-yaw) R R_z(roll), z' = z + height; differentiable in the mounting.

    A camera over pitch p, roll r and height h, turned by any yaw, becomes the one over p + pitch, r + roll and
    h + height: pitch tilts the optical axis down, roll turns about it.
    """
    pose = jnp.asarray(camera.base_from_camera)
    ahead = jax.lax.stop_gradient(pose[:2, 2])
    # Looking straight down there is no yaw to keep.
    level = jnp.linalg.norm(ahead)
    cy, sy = jnp.where(level > 1e-6, ahead / jnp.maximum(level, 1e-6), jnp.array([1.0, 0.0], pose.dtype))
    pitch, roll, height = (
        jnp.asarray(v, pose.dtype) for v in (mounting.pitch_rad, mounting.roll_rad, mounting.height_m)
    )
    s, c, sr, cr = jnp.sin(pitch), jnp.cos(pitch), jnp.sin(roll), jnp.cos(roll)
    zero, one = jnp.zeros_like(s), jnp.ones_like(s)
    nod = jnp.stack([jnp.stack([c, zero, s]), jnp.stack([zero, one, zero]), jnp.stack([-s, zero, c])])
    turned = jnp.stack([jnp.stack([cy, -sy, zero]), jnp.stack([sy, cy, zero]), jnp.stack([zero, zero, one])])
    tilt = turned @ nod @ turned.T
    turn = jnp.stack([jnp.stack([cr, -sr, zero]), jnp.stack([sr, cr, zero]), jnp.stack([zero, zero, one])])
    pose = pose.at[:3, :3].set(tilt @ pose[:3, :3] @ turn)
    return dataclasses.replace(camera, base_from_camera=pose.at[2, 3].add(height))
