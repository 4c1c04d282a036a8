"""What a path says of columns that no header names: the order of a quaternion's parts, and the unit of angles.

A robot or a camera on it moves along nearly one axis of its own. Read in the wrong order or unit, the orientation does
not turn with the path. A path that says too little decides nothing.
"""

import numpy as np
from jaxtyping import Float

from ebjax.io.heading_check import MAX_TURN_RAD, directions, spread_rad
from ebjax.io.path_evidence import extent_m, steps, thinned
from ebjax.io.poses import poses_from, rotation_from_quaternion

ENOUGH_STEPS = 10
ASTRAY = 0.2
ALONG = 0.3
CLEARLY = 0.5


def _astray(quaternion: Float[np.ndarray, "N 4"], positions: Float[np.ndarray, "N 3"]) -> tuple[float, float] | None:
    """How little a body (wxyz) moves along one axis of its own: both ways, 0 to 2/3, and one way, 0 to 1.

    Returns:
      None for a path too short.
    """
    poses = thinned(poses_from(rotation_from_quaternion(quaternion), positions))
    rotation, places = poses[:, :3, :3], poses[:, :3, 3]
    start, end = steps(places, max(extent_m(places) / 30, 1e-6))
    if len(start) < ENOUGH_STEPS:
        return None
    ahead = places[end] - places[start]
    ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    seen = np.einsum("sji,sj->si", (rotation[start] + rotation[end]) / 2, ahead)
    # Where the body turns far within a step its axes half-way are unknown.
    seen = seen / np.maximum(np.linalg.norm(seen, axis=1, keepdims=True), 0.5)
    both_ways = float(np.linalg.eigvalsh(seen.T @ seen / len(seen))[-1])
    return 1 - both_ways, 1 - float(np.linalg.norm(seen.mean(axis=0)))


def w_stands_first(quaternion: Float[np.ndarray, "N 4"], positions: Float[np.ndarray, "N 3"]) -> bool | None:
    """Whether quaternions of a path, their parts in a file's order, are wxyz, not xyzw.

    Returns:
      None where the path does not tell, as one without turns or one of a camera in the hand.
    """
    w_last, w_first = _astray(quaternion[:, [3, 0, 1, 2]], positions), _astray(quaternion, positions)
    if w_last is None or w_first is None:
        return None
    votes = {
        first < last
        for last, first in zip(w_last, w_first, strict=True)
        if min(first, last) <= min(ALONG, CLEARLY * max(first, last)) and max(first, last) >= ASTRAY
    }
    return votes.pop() if len(votes) == 1 else None


def looks_w_first(quaternion: Float[np.ndarray, "N 4"]) -> bool:
    """Whether the first of four parts is what w is where a run starts, or goes on, nearly without rotation."""
    first = np.abs(quaternion[:, 0])
    return bool(first[0] > 0.999 or np.median(first) > 0.9)


def angle_unit(positions: Float[np.ndarray, "N 3"], yaw: Float[np.ndarray, " N"]) -> str:
    """The unit in which angles turn with their path: rad, deg, or "" where it does not tell."""
    poses = poses_from(np.tile(np.eye(3), (len(positions), 1, 1)), positions)
    spread = {}
    for unit, scale in (("rad", 1.0), ("deg", np.pi / 180)):
        path, half_way, turn = directions(poses, np.unwrap(scale * yaw))
        straight = np.abs(turn) < MAX_TURN_RAD
        # Steps that turn far are left out, unless most do, as they would in the wrong unit.
        straight |= straight.sum() < len(straight) / 2
        angles = (path - half_way)[straight]
        spread[unit] = spread_rad(angles, 2) if len(angles) >= ENOUGH_STEPS else float("nan")
    for unit, other in (("rad", "deg"), ("deg", "rad")):
        if spread[unit] < np.radians(30) and spread[other] > np.radians(3) and spread[unit] < 0.4 * spread[other]:
            return unit
    return ""
