"""Small planar conversions that the run needs: poses of the base as matrices and as (x, y, heading)."""

import numpy as np
from jaxtyping import Float


def planar(poses: Float[np.ndarray, "N 4 4"]) -> Float[np.ndarray, "N 3"]:
    """x, y (m) and heading (rad, unwrapped) of 4 x 4 poses; height, roll and pitch are left out."""
    heading = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    known = np.isfinite(heading)
    heading[known] = np.unwrap(heading[known])
    return np.stack([poses[:, 0, 3], poses[:, 1, 3], heading], 1)


def matrices(poses: Float[np.ndarray, "N 3"], like: Float[np.ndarray, "N 4 4"] | None = None) -> np.ndarray:
    """4 x 4 poses of (x, y, heading); height, roll and pitch as in `like` (of the same frames), else zero."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    turn = np.tile(np.eye(4), (len(poses), 1, 1))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = c, -s, s, c
    if like is not None:
        heading = np.arctan2(like[:, 1, 0], like[:, 0, 0])
        level = matrices(np.stack([np.zeros_like(heading), np.zeros_like(heading), -heading], 1)) @ like
        level[:, :2, 3] = 0
        turn = turn @ level
    turn[:, :2, 3] = poses[:, :2]
    return turn
