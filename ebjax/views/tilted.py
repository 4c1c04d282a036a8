"""The floor view of a robot that pitches and rolls: each frame is looked at through the camera as it stood then.

A level base follows the robot over the floor; level_from_base is how the robot leans in it. All views of a run show the
same rectangle of floor in the level base, so nothing behind them knows of the tilt.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ebjax.geometry.camera import Camera, field_of_view, image_from_floor
from ebjax.geometry.homography import Arrays
from ebjax.geometry.lean_numbers import levels, spread_deg, turned
from ebjax.views.run_view import RunView

LEAST_SPREAD_DEG = 0.02
SLOPE_M = 0.5
"""Half the way over which the floor's own slope is taken from a path."""


@jax.jit
def tilted(view: RunView, camera: Camera, level_from_base: Float[Arrays, "4 4"]) -> tuple[RunView, Camera]:
    """The view and the camera of one frame; base of what they return is the level base."""
    pose = jnp.asarray(camera.base_from_camera)
    camera = dataclasses.replace(camera, base_from_camera=jnp.asarray(level_from_base, pose.dtype) @ pose)
    homography = image_from_floor(camera) @ view.floor_from_view
    seen = view.seen & field_of_view(camera, homography, view.size, 1.0)
    return dataclasses.replace(view, image_from_view=homography, seen=seen), camera


def tilt_of_poses(odom_from_base: Float[np.ndarray, "F 4 4"]) -> Float[np.ndarray, "F 4 4"] | None:
    """How the robot leans against the floor by odometry's roll and pitch: level_from_base; None where it does not say.

    Planar odometry writes no tilt, and a tilt that never changes is the mount's. Where the path climbs, the floor does
    too: its slope over a metre of way is taken from the pitch.
    """
    level = levels(odom_from_base[:, 2, :3])
    if spread_deg(level) < LEAST_SPREAD_DEG:
        return None
    return turned(1, _slope(odom_from_base)) @ level


def _slope(odom_from_base: Float[np.ndarray, "F 4 4"]) -> Float[np.ndarray, " F"]:
    """How steeply the floor rises ahead of the robot, rad, where the path's height says so."""
    step = np.diff(odom_from_base[:, :3, 3], axis=0)
    ahead = np.sum(step[:, :2] * odom_from_base[:-1, :2, 0], axis=1)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(step[:, :2], axis=1))])
    forward = np.concatenate([[0.0], np.cumsum(ahead)])
    height = odom_from_base[:, 2, 3]
    before = np.searchsorted(way, way - SLOPE_M)
    after = np.searchsorted(way, way + SLOPE_M, side="right") - 1
    run = forward[after] - forward[before]
    steady = np.abs(run) > SLOPE_M
    return np.where(steady, np.arctan2(height[after] - height[before], np.where(steady, run, 1.0)), 0.0)
