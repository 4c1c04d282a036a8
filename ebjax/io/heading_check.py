"""Whether a robot's heading goes with its path: the angle from its x axis to where it moves, over steps of the path.

A car's angle is 0 or half a turn, a robot's that drives sideways is anything. So no angle is refused for itself, only
where a named fault explains it: taken back, it leaves the robot driving along its axes.
"""

import numpy as np
from jaxtyping import Float

from ebjax.io.path_evidence import MAX_POSES, SHORT_M, extent_m, steps, sweeps, thinned
from ebjax.io.pose_readings import INVERSE
from ebjax.io.poses import invert

ENOUGH_STEPS = 20
MAX_TURN_RAD = np.radians(30)
CONJUGATED = (
    "base_link's heading turns left where its path turns right: the quaternions are conjugated (the inverse rotation), "
    "or x or y has the wrong sign. Give x forward, y left, and turns to the left positive"
)
DEGREES = (
    "base_link's heading turns {} as far as its path: {} when the quaternions were made. "
    "Make them from angles in radians"
)
WILD = (
    "base_link's heading jumps about from step to step while its path runs smoothly: angles in degrees were taken for "
    "radians when the quaternions were made, or the columns are not `timestamp tx ty tz qx qy qz qw`. Make them from "
    "angles in radians, and qw last"
)
TOO_FAR = DEGREES.format("57 times", "degrees were taken for radians")
TOO_LITTLE = DEGREES.format("1/57", "radians were taken for degrees")
SIDES = ("", "to its left", "backwards", "to its right")


def heading_of(poses: Float[np.ndarray, "N 4 4"]) -> Float[np.ndarray, " N"]:
    """The heading of every pose, without jumps of a whole turn, rad."""
    return np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))


def directions(
    poses: Float[np.ndarray, "N 4 4"], heading: Float[np.ndarray, " N"]
) -> tuple[Float[np.ndarray, " S"], Float[np.ndarray, " S"], Float[np.ndarray, " S"]]:
    """Where each step of a path goes, the heading half-way and how far it turns, rad; none for a path too short."""
    every = -(-len(poses) // MAX_POSES)
    places, heading = poses[::every, :3, 3], heading[::every]
    extent = extent_m(places)
    start, end = steps(places, float(np.clip(extent / 30, 0.1, 0.3)))
    start, end = (start, end) if extent >= SHORT_M else (start[:0], end[:0])
    ahead = places[end] - places[start]
    return np.arctan2(ahead[:, 1], ahead[:, 0]), (heading[start] + heading[end]) / 2, heading[end] - heading[start]


def mean_rad(angles: Float[np.ndarray, " S"], fold: int) -> float:
    """The circular mean of angles that repeat every 1/fold of a turn, rad."""
    return float(np.angle(np.exp(1j * fold * angles).mean())) / fold


def size_rad(angles: Float[np.ndarray, " S"], fold: int) -> Float[np.ndarray, " S"]:
    """How far angles that repeat every 1/fold of a turn are from 0, rad."""
    return np.abs(np.angle(np.exp(1j * fold * angles))) / fold


def spread_rad(angles: Float[np.ndarray, " S"], fold: int) -> float:
    """The circular standard deviation of angles that repeat every 1/fold of a turn, rad."""
    length = np.clip(np.abs(np.exp(1j * fold * angles).mean()), 1e-9, 1 - 1e-12)
    return float(np.sqrt(-2 * np.log(length)) / fold)


def _explained(
    poses: Float[np.ndarray, "N 4 4"],
    heading: Float[np.ndarray, " N"],
    scale: float,
    fold: int,
    least_deg: float,
    share: float,
) -> bool:
    """Whether `scale` times the heading goes with the path, and neither the heading itself nor none at all does.

    Args:
      poses: world_from_base.
      heading: theirs, rad.
      scale: what the heading is multiplied by.
      fold: 2 where driving backwards is as good.
      least_deg: how much the angle from the heading to the path must spread, as read.
      share: how much of that may be left.
    """
    path, half_way, turn = directions(poses, heading)
    straight = np.abs(scale * turn) < MAX_TURN_RAD
    path, half_way = path[straight], half_way[straight]
    if len(path) < ENOUGH_STEPS:
        return False
    found, read, none = (spread_rad(path - s * half_way, fold) for s in (scale, 1.0, 0.0))
    return bool(read >= np.radians(least_deg) and found <= share * min(read, none))


def heading_fault(poses: Float[np.ndarray, "N 4 4"]) -> str:
    """Names what is wrong with the headings of world_from_base poses, or returns "" where nothing is known to be."""
    heading = heading_of(poses)
    if _explained(poses, heading, -1.0, 2, 4.0, 0.4):
        return CONJUGATED
    if _explained(poses, heading, np.pi / 180, 1, 40.0, 0.25):
        return TOO_FAR
    if _explained(poses, heading, 180 / np.pi, 1, 40.0, 0.25):
        return TOO_LITTLE
    if _wild(poses, heading):
        return WILD
    return INVERSE if _inverted(poses) else ""


def _inverted(poses: Float[np.ndarray, "N 4 4"]) -> bool:
    """Whether the inverse drives along its axes, and less far."""
    inverse = invert(poses)
    path, half_way, turn = directions(inverse, heading_of(inverse))
    angles = (path - half_way)[np.abs(turn) < MAX_TURN_RAD]
    if len(angles) < ENOUGH_STEPS or spread_rad(angles, 2) > np.radians(10):
        return False
    return sweeps(thinned(poses), thinned(inverse))


def _wild(poses: Float[np.ndarray, "N 4 4"], heading: Float[np.ndarray, " N"]) -> bool:
    """Whether the heading jumps about from step to step along a smooth path."""
    path, half_way, _ = directions(poses, heading)
    if len(path) <= ENOUGH_STEPS:
        return False
    jumps = np.diff(half_way)
    jumps = np.median(size_rad(jumps - mean_rad(jumps, 1), 1))
    bends = np.median(size_rad(np.diff(path), 2))
    return bool(jumps > np.radians(30) and bends < np.radians(10))


def side_note(poses: Float[np.ndarray, "N 4 4"]) -> str:
    """Says where base_link drives if it is not forwards, or returns "": legal, but more often its frame is wrong."""
    path, half_way, turn = directions(poses, heading_of(poses))
    straight = np.abs(turn) < MAX_TURN_RAD
    angles = (path - half_way)[straight | (straight.sum() < len(path) / 2)]
    if len(angles) < ENOUGH_STEPS:
        return ""
    away = float(np.median(size_rad(angles - mean_rad(angles, 2), 2)))
    if away > np.radians(12):
        return (
            f"base_link drives at any angle to its x axis (half of its path lies over {np.degrees(away):.0f} degrees "
            "off the mean); if it cannot drive sideways, its headings are wrong"
        )
    if (size_rad(angles - mean_rad(angles, 1), 1) < np.pi / 2).mean() > 0.95:
        where = SIDES[round(mean_rad(angles, 1) / (np.pi / 2)) % 4]
    else:
        where = "sideways" if abs(mean_rad(angles, 2)) > np.pi / 4 else ""
    if not where:
        return ""
    return f"base_link drives {where} nearly all the way; if it does not, its axes are wrong (x forward, y left, z up)"
