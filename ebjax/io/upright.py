"""The poses of a robot on floors stand upright and move level: what a file holds in place of that, named or put right.

Nothing is refused but what a robot on floors cannot do: ramps of 15 degrees, reversing, driving sideways, nodding,
standing and jumps pass unchanged. A path too short to judge passes.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from ebjax.io.heading_check import heading_fault, side_note
from ebjax.io.path_evidence import TILT_DEG, UPRIGHT_SHARE, Evidence, sweeps, thinned
from ebjax.io.pose_readings import FLOOR_FRAMES, W_FIRST, Reading, camera_body, camera_body_readings, readings
from ebjax.io.poses import invert
from ebjax.io.trajectory import Trajectory

AS_READ = Reading("", np.eye(4), np.eye(4))
LEAST_CAMERA_TILT_DEG = 8.0
MOST_LEAN_DEG = 15.0


def floor_trajectory(
    trajectory: Trajectory, base_from_camera: Float[np.ndarray, "4 4"]
) -> tuple[Trajectory, tuple[str, ...]]:
    """Checks that a file holds poses of base_link in a world with z up; those of the camera are put right.

    Args:
      trajectory: as read.
      base_from_camera: from camera.json.

    Returns:
      The trajectory, unchanged where nothing is wrong, and a line for each thing the user should know.

    Raises:
      ValueError: other columns, frames or headings; names the file, what it holds and the remedy.
    """
    poses = thinned(trajectory.poses)
    reading = _reading(trajectory.path, poses, base_from_camera)
    notes = []
    if reading.says:
        if not reading.right:
            raise ValueError(f"{trajectory.path}: {reading.says}")
        notes.append(f"{trajectory.path}: {reading.says}")
        trajectory = dataclasses.replace(trajectory, poses=reading.apply(trajectory.poses))
    if fault := heading_fault(trajectory.poses):
        raise ValueError(f"{trajectory.path}: {fault}")
    if note := side_note(trajectory.poses):
        notes.append(f"{trajectory.path}: {note}")
    return trajectory, tuple(notes)


def _reading(path: str, poses: Float[np.ndarray, "N 4 4"], base_from_camera: Float[np.ndarray, "4 4"]) -> Reading:
    read = AS_READ.measure(poses)
    if read.fits:
        return _closer(read, poses, base_from_camera)
    swept = sweeps(poses, invert(poses))
    found = [(r, r.measure(poses)) for r in readings(base_from_camera) if swept or not r.inverted]
    found = [(r, evidence) for r, evidence in found if evidence.fits and evidence.lean_deg < MOST_LEAN_DEG]
    if not found:
        raise ValueError(f"{path}: {_unnamed(read, poses)}")
    least = min(evidence.cost_deg for _, evidence in found)
    return next(reading for reading, evidence in found if evidence.cost_deg <= 1.5 * least + 0.5)


def _closer(read: Evidence, poses: Float[np.ndarray, "N 4 4"], base_from_camera: Float[np.ndarray, "4 4"]) -> Reading:
    """Tells a base from what looks like one: a camera's body that hardly tilts, w first near half a turn."""
    w_first = Reading(W_FIRST, np.eye(4), np.eye(4), w_first=True)
    other = w_first.measure(poses)
    better = other.fits and other.tilt_deg < read.tilt_deg / 5 and other.astray_deg < read.astray_deg / 2
    if better and min(read.tilt_deg, read.astray_deg) > 2:
        return w_first
    tilt = np.degrees(np.arccos(np.clip(camera_body(base_from_camera)[2, 2], -1, 1)))
    # On a ramp a robot tilts too, but it moves in its own x-y plane.
    if min(tilt, read.lift_deg) < LEAST_CAMERA_TILT_DEG:
        return AS_READ
    bodies = [(body.measure(poses), body) for body in camera_body_readings(base_from_camera)]
    other, body = min(bodies, key=lambda pair: pair[0].cost_deg)
    near = other.fits and other.lift_deg < read.lift_deg / 3
    return body if near and other.tilt_deg + other.slope_deg < (read.tilt_deg + read.slope_deg) / 3 else AS_READ


def _unnamed(read: Evidence, poses: Float[np.ndarray, "N 4 4"]) -> str:
    """What is wrong where no reading fits."""
    if read.upright < UPRIGHT_SHARE:
        seen = f"base_link stands upright (z within {TILT_DEG:g} degrees of up) in {read.upright:.0%} of the poses only"
    else:
        seen = f"base_link's path is steeper than {TILT_DEG:g} degrees over {1 - read.level:.0%} of its length"
    # The body's axis that keeps its direction while the body turns is the one that points up.
    left, size, right = np.linalg.svd(poses[:, :3, :3].mean(axis=0))
    if size[0] > 0.97 and size[1] < 0.9:
        up, world = right[0] * np.sign(left[:, 0][np.abs(left[:, 0]).argmax()]), left[:, 0]
        world = world * np.sign(world[np.abs(world).argmax()])
        axis, fixed = (", ".join(f"{v + 0.0:.2f}" for v in np.round(a, 2)) for a in (up, world))
        seen += f"; the moving frame turns about its axis ({axis}), which is ({fixed}) in the file's world"
    return f"{seen}. Give {FLOOR_FRAMES}"
