"""What a file of poses may hold in place of world_from_base: other columns, other frames of the body or the world.

A camera's frames are put right, since camera.json says where the camera sits; the others are refused by name.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ebjax.io.path_evidence import Evidence, level_steps, measure
from ebjax.io.poses import invert, poses_from, quaternion_from_rotation, rotation_from_quaternion

OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
HALF_TURN = np.diag([1.0, -1.0, -1.0])
Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
FLOOR_FRAMES = "the poses of base_link (x forward, y left, z up) in a world with z up"
W_FIRST = (
    "its quaternions are written qw qx qy qz: so read base_link stands upright, read as qx qy qz qw it does not. "
    "Write the columns as `timestamp tx ty tz qx qy qz qw`, or make `# timestamp tx ty tz qw qx qy qz` the first line"
)
INVERSE = (
    "its poses are inverted: they map the world into the moving frame. Write the inverse of each pose, "
    "(R, t) -> (R^T, -R^T t), so that it maps points of the moving frame into the world"
)
UPSIDE_DOWN = (
    "base_link is upside down, its z axis points down: the moving frame is forward-right-down (FRD) or the world "
    f"north-east-down (NED). Give {FLOOR_FRAMES}: multiply each pose by diag(1, -1, -1, 1), from the right for "
    "FRD, from the left for NED"
)


@dataclass(frozen=True)
class Reading:
    """A way to understand the poses of a file.

    Attributes:
      says: what the file holds, for a note (put right) or an error (not).
      base_from_body: the body whose poses the file holds.
      level_from_world: turns the file's world so that z is up.
      right: whether the poses can be put right; else the file is refused.
      w_first: whether the quaternions are written w first.
      inverted: whether the poses are body_from_world.
    """

    says: str
    base_from_body: Float[np.ndarray, "4 4"]
    level_from_world: Float[np.ndarray, "4 4"]
    right: bool = False
    w_first: bool = False
    inverted: bool = False

    def apply(self, poses: Float[np.ndarray, "N 4 4"]) -> Float[np.ndarray, "N 4 4"]:
        """Returns world_from_base."""
        if self.w_first:
            poses = reordered(poses)
        if self.inverted:
            poses = invert(poses)
        return self.level_from_world @ poses @ np.linalg.inv(self.base_from_body)

    def measure(self, poses: Float[np.ndarray, "N 4 4"]) -> Evidence:
        """Measures the poses so read."""
        read = self.apply(poses)
        return measure(read[:, :3, :3], read[:, :3, 3], level_steps(read[:, :3, 3]))


def reordered(poses: Float[np.ndarray, "N 4 4"]) -> Float[np.ndarray, "N 4 4"]:
    """Reads the quaternions as qw qx qy qz where they were read as qx qy qz qw."""
    w, x, y, z = quaternion_from_rotation(poses[:, :3, :3]).T
    return poses_from(rotation_from_quaternion(np.stack([x, y, z, w], axis=1)), poses[:, :3, 3])


def _frame(rotation: Float[np.ndarray, "3 3"], place: Float[np.ndarray, "3"] | None = None) -> Float[np.ndarray, "4 4"]:
    return poses_from(rotation[None], np.zeros((1, 3)) if place is None else place[None])[0]


def camera_body(base_from_camera: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """The camera's frame with the axes of a body: x where it looks, y left, z up; base_from_body."""
    return _frame(base_from_camera[:3, :3] @ OPTICAL.T, base_from_camera[:3, 3])


def camera_body_readings(base_from_camera: Float[np.ndarray, "4 4"]) -> list[Reading]:
    """The camera's frame with the axes of a body, in a level world and in one that starts at the camera."""
    body = camera_body(base_from_camera)
    says = (
        "holds the poses of the camera's own body (x where it looks, y left, z up), not of base_link: "
        "put right with T_base_camera"
    )
    return [Reading(says, body, world, right=True) for world in (np.eye(4), body)]


def readings(base_from_camera: Float[np.ndarray, "4 4"]) -> list[Reading]:
    """All that a file that is not world_from_base may hold, the likelier first."""
    same = np.eye(4)
    optical, levelled = base_from_camera, _frame(OPTICAL, base_from_camera[:3, 3])
    opengl = _frame(base_from_camera[:3, :3] @ HALF_TURN)
    says = (
        "holds the poses of the camera's optical frame (x right, y down, z forward), not of base_link: "
        "put right with T_base_camera"
    )
    says_level = f"{says}, the camera taken as level"
    camera_world = "from a world that has the first camera's axes (y down, z forward) to one with z up"
    looks_ahead = camera_body(base_from_camera)[2, 2] > np.cos(np.radians(45))
    level = [
        Reading(says_level, levelled, same, right=True),
        Reading(f"{says_level}, {camera_world}", levelled, _frame(OPTICAL), right=True),
    ]
    gl = (
        "it holds the poses of a camera with OpenGL's axes (x right, y up, z backward), not of base_link"
        f"{{}}. Give {FLOOR_FRAMES}"
    )
    # Its y up and the optical y down look the same turned over; only the direction of driving tells them apart.
    gl, gl_or_reversing = gl.format(""), gl.format(", or of a camera's optical frame that was driven backwards")
    leaves = "base_link's path leaves the floor: the file's world has its y axis {}, not z up. Multiply each pose by {}"
    y_up = leaves.format("up", "[[1,0,0,0],[0,0,-1,0],[0,1,0,0],[0,0,0,1]] from the left")
    y_down = leaves.format("down", "[[0,0,1,0],[-1,0,0,0],[0,-1,0,0],[0,0,0,1]] from the left")
    return [
        Reading(W_FIRST, same, same, w_first=True),
        Reading(says, optical, same, right=True),
        Reading(f"{says}, {camera_world}", optical, optical, right=True),
        Reading(f"{says}, {camera_world}", optical, _frame(OPTICAL), right=True),
        *camera_body_readings(base_from_camera),
        *(level if looks_ahead else []),
        Reading(UPSIDE_DOWN, _frame(HALF_TURN), same),
        Reading(y_up, same, _frame(Y_UP)),
        Reading(y_down, same, _frame(OPTICAL)),
        Reading(gl, opengl, same),
        Reading(gl_or_reversing, opengl, opengl),
        Reading(gl_or_reversing, opengl, _frame(Y_UP)),
        Reading(W_FIRST, optical, same, w_first=True),
        Reading(W_FIRST, optical, optical, w_first=True),
        Reading(INVERSE, optical, same, inverted=True),
        Reading(INVERSE, optical, optical, inverted=True),
        Reading(W_FIRST, optical, same, w_first=True, inverted=True),
    ]
