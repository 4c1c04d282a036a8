"""Depth in the colour camera: as it is where both are of one frame, else moved there by tf and both cameras."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Float32

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.logs.bag import Bag
from ebjax.io.logs.ros_camera_info import calibration_from
from ebjax.io.logs.ros_collect import Collected
from ebjax.io.logs.ros_depth import depth_from, registered
from ebjax.io.logs.ros_message import Image
from ebjax.io.logs.ros_mount import frame_from_optical
from ebjax.io.logs.ros_tf import TfTree
from ebjax.io.logs.ros_topics import Topics
from ebjax.io.poses import invert

Decoder = Callable[[Image, str], np.ndarray]
REMEDY = "record depth that is registered to colour, or go without depth"


def _optical(tree: TfTree, base: str | None, frame: str, times: np.ndarray) -> Float[np.ndarray, "4 4"]:
    return np.eye(4) if base is None else frame_from_optical(tree, base, frame, times)[0]


def _colour_from_depth(
    tree: TfTree, base: str | None, frames: tuple[str, str], times: Float[np.ndarray, " N"]
) -> Float[np.ndarray, "4 4"] | None:
    """Between the two optical frames at the first image; None where tf does not join them."""
    poses = tree.at(*frames, times)
    poses = poses[np.isfinite(poses).all(axis=(1, 2))]
    if not len(poses):
        return None
    turns = [_optical(tree, base, frame, times) for frame in frames]
    return invert(turns[0][None])[0] @ poses[0] @ turns[1]


def _same_view(depth: Calibration, colour: Calibration, colour_from_depth: Float[np.ndarray, "4 4"]) -> bool:
    scale = depth.width / colour.width
    fields = np.array([[scale, scale, scale], [scale, scale, scale], [1, 1, 1]]) * colour.intrinsics
    return bool(
        np.abs(colour_from_depth - np.eye(4)).max() < 1e-4 and np.abs(fields - depth.intrinsics).max() < 1 + scale
    )


def depth_decoder(
    bag: Bag,
    found: Collected,
    topics: Topics,
    tree: TfTree,
    base: str | None,
    camera: Calibration | None,
    times: Float[np.ndarray, " N"],
) -> tuple[Decoder, tuple[str, ...]]:
    """How a depth message becomes depth in the colour camera, and notes.

    Args:
      bag: opened.
      found: what was read of it.
      topics: those chosen, with depth.
      tree: the log's frames.
      base: the base's frame, None where the mount is not known.
      camera: the colour camera.
      times: of the colour images, s.

    Raises:
      ValueError: depth is of another frame, and a transform or a camera is missing; names the topic.
    """
    assert topics.depth is not None
    name = bag.channels[topics.depth].topic
    frames = (topics.frames[topics.image], topics.frames[topics.depth])
    if frames[0] == frames[1] or not all(frames):
        return depth_from, ()
    what = f"{name} is of frame {frames[1]}, the images of {frames[0]}"
    colour_from_depth = _colour_from_depth(tree, base, frames, times)
    if colour_from_depth is None:
        if any(word in name for word in ("aligned", "registered")):
            return depth_from, (f"{what}; taken as registered by its name",)
        raise ValueError(f"{what}, and tf has no transform between them; {REMEDY}")
    depth_camera = None
    if topics.depth_info is not None:
        info = bag.channels[topics.depth_info].topic
        depth_camera = calibration_from(found.camera_infos(topics.depth_info), info, f"{info} of {bag.path}", name)
    if depth_camera is None or camera is None:
        raise ValueError(
            f"{what}, and the CameraInfo of {'the images' if camera is None else name} is missing; {REMEDY}"
        )
    if _same_view(depth_camera, camera, colour_from_depth):
        return depth_from, ()
    for of, one in ((name, depth_camera), ("the images", camera)):
        if one.distortion_model != "pinhole":
            raise ValueError(f"{what}, and the lens of {of} bends ({one.distortion_model}); {REMEDY}")
    from_camera, to_camera = depth_camera, camera

    def decode(message: Image, kind: str) -> Float32[np.ndarray, "H W"]:
        depth = depth_from(message, kind)
        height, width = depth.shape
        intrinsics = from_camera.scaled(width, height).intrinsics
        size = (to_camera.width, to_camera.height)
        return registered(depth, intrinsics, to_camera.intrinsics, size, colour_from_depth)

    return decode, (f"{what}; depth is moved into their camera by tf and both CameraInfos",)
