"""Where the camera sits on the robot: base_from_camera, to its optical frame, from tf."""

import numpy as np
from jaxtyping import Float

from ebjax.io.logs.ros_tf import TfTree
from ebjax.io.poses import invert

BODY_FROM_OPTICAL = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
MOST_MOVE_M, MOST_TURN_DEG = 1e-3, 0.1


def movement(poses: Float[np.ndarray, "N 4 4"]) -> tuple[float, float]:
    """How far poses lie from the first of them: m, degrees."""
    apart = invert(poses[:1]) @ poses
    cosine = (np.trace(apart[:, :3, :3], axis1=1, axis2=2) - 1) / 2
    sine = np.linalg.norm(apart[:, :3, :3] - np.swapaxes(apart[:, :3, :3], 1, 2), axis=(1, 2)) / np.sqrt(8)
    turn = np.rad2deg(np.arctan2(sine, cosine))
    return float(np.linalg.norm(apart[:, :3, 3], axis=1).max()), float(turn.max())


def frame_from_optical(
    tree: TfTree, base: str, frame: str, times: Float[np.ndarray, " N"]
) -> tuple[Float[np.ndarray, "4 4"], tuple[str, ...]]:
    """The turn from an image's frame to its optical frame: none, unless the frame is a body's (x ahead, z up)."""
    poses = tree.at(base, frame, times)
    poses = poses[np.isfinite(poses).all(axis=(1, 2))]
    is_body = len(poses) > 0 and poses[0, 2, 2] > 0.5
    if not is_body:
        return np.eye(4), ()
    if "optical" in frame.rsplit("/", 1)[-1]:
        return np.eye(4), (f"tf: z of {frame} points up although it is called optical; check the mount",)
    note = f"tf: {frame} is a body frame (x ahead, z up), not an optical one; the camera is turned to look along its x"
    return BODY_FROM_OPTICAL, (note,)


def mount(
    tree: TfTree, frame: str, times: Float[np.ndarray, " N"]
) -> tuple[Float[np.ndarray, "4 4"] | None, str | None, tuple[str, ...]]:
    """base_from_camera at the first image.

    Args:
      tree: the log's frames.
      frame: the images'.
      times: the images', s.

    Returns:
      The transform, None where tf does not join the frame with a base; the base's frame; notes.
    """
    base = tree.base(frame)
    if base is None or base == frame:
        return None, None, ()
    poses = tree.at(base, frame, times)
    poses = poses[np.isfinite(poses).all(axis=(1, 2))]
    if not len(poses):
        return None, base, (f"tf: no transform from {base} to {frame} at the time of any image",)
    turn, notes = frame_from_optical(tree, base, frame, times)
    moved_m, turned_deg = movement(poses)
    if moved_m > MOST_MOVE_M or turned_deg > MOST_TURN_DEG:
        notes += (
            f"tf: {frame} moves on {base} by up to {moved_m:.3f} m and {turned_deg:.1f} deg over the log; its place at "
            "the first image is used",
        )
    return poses[0] @ turn, base, (f"tf: the camera's mount is {frame} in {base}", *notes)
