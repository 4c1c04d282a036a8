"""How poses lean against upright, as numbers: NumPy alone, so that readers need no JAX."""

import numpy as np
from jaxtyping import Float


def headings(poses: Float[np.ndarray, "N 4 4"]) -> Float[np.ndarray, " N"]:
    """Where x of poses points to over the floor, rad."""
    return np.arctan2(poses[:, 1, 0], poses[:, 0, 0])


def turned(axis: int, angle: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N 4 4"]:
    """Rotations about x, y or z."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    found = np.tile(np.eye(4), (len(angle), 1, 1))
    found[:, i, i], found[:, i, j], found[:, j, i], found[:, j, j] = c, -s, s, c
    return found


def levels(up: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 4 4"]:
    """level_from_base of a base that sees up there: roll and pitch alone. Of a pose, up is its third row."""
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    ahead = np.array([1.0, 0, 0]) - up[:, :1] * up
    ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    found = np.tile(np.eye(4), (len(up), 1, 1))
    found[:, :3, :3] = np.stack([ahead, np.cross(up, ahead), up], axis=1)
    return found


def levels_from_usual(up: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 4 4"]:
    """As `levels`, against the usual up: what a sensor always shows is how it is mounted.

    The usual is the mean without the tenth at either end: a nod's median is of no use, as it swings between two ends.
    """
    cut = len(up) // 10
    usual = levels(np.sort(up, axis=0)[cut : len(up) - cut].mean(axis=0, keepdims=True))
    return levels((levels(up) @ np.swapaxes(usual, 1, 2))[:, 2, :3])


def spread_deg(level_from_base: Float[np.ndarray, "N 4 4"]) -> float:
    """How far roll or pitch, whichever changes more, comes about over all of them, degrees."""
    return float(np.degrees(np.ptp(np.arcsin(np.clip(level_from_base[:, 2, :2], -1, 1)), axis=0)).max())
