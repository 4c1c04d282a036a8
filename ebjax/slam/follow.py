"""A run without wheels: the floor follows the robot from frame to frame and says which frames are keyframes."""

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from ebjax.geometry.camera import Camera
from ebjax.geometry.planar import chained, inverse
from ebjax.odometry.floor_steps import table_of, verified_pairs
from ebjax.odometry.motion import MotionConfig
from ebjax.slam.describe import Described
from ebjax.views.run_view import RunView


def follow(
    described: Described,
    frames: Int[np.ndarray, " N"],
    timestamps: Float[np.ndarray, " F"],
    view: RunView,
    camera: Camera,
    keyframe_m: float,
    keyframe_deg: float,
    config: MotionConfig,
) -> tuple[Int[np.ndarray, " n"], Described, Float[np.ndarray, "F 3"], Bool[np.ndarray, " M"]]:
    """Measures every frame against the one before; a step that fails goes on at the last speed.

    A frame is a keyframe where the robot has moved or turned enough since the last one, and at either side of a step
    that failed.

    Returns:
      The keyframes' frame numbers, their descriptions, where every frame is thought to be, and which frames the floor
      showed to follow on the one before.
    """
    count = len(frames)
    later, earlier = np.arange(1, count), np.arange(count - 1)

    pairs = verified_pairs(
        described.landmarks, view, camera, later, earlier, tolerance_m=config.tolerance_m, seed=config.seed + 2
    )
    table = table_of(pairs, camera, config.tolerance_m)
    step, good = inverse(table.i_from_j), table.used
    seconds = np.diff(timestamps[frames])
    speed = np.zeros(3)
    for k in range(count - 1):
        if good[k]:
            speed = step[k] / seconds[k]
        else:
            step[k] = speed * seconds[k]
    path = chained(step)
    chosen = [0]
    for k in range(1, count):
        moved = path[k] - path[chosen[-1]]
        far = np.hypot(moved[0], moved[1]) >= keyframe_m or abs(moved[2]) >= np.radians(keyframe_deg)
        # Both ends of a failed step, so that something else may measure it.
        if not good[k - 1] and chosen[-1] < k - 1:
            chosen.append(k - 1)
        if far or not good[k - 1]:
            chosen.append(k)
    rows = np.array(chosen)
    every = np.stack([np.interp(np.arange(len(timestamps)), frames, path[:, axis]) for axis in range(3)], 1)
    return frames[rows], jax.tree.map(lambda leaf: leaf[rows], described), every, good
