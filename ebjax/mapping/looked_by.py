"""What a session was looked at with, its camera and its floor view, as the map's file keeps it."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ebjax.geometry.camera import Camera
from ebjax.io.camera_file import CameraFile
from ebjax.views.run_view import RunView

NAME = "looked by"
"""Of the session's state."""


class LookedBy(NamedTuple):
    """The camera as it is mounted, and its floor view: pixel (u, v, 1) -> (x, y, 1) in base (m), and what is seen."""

    camera: CameraFile
    floor_from_view: Float[np.ndarray, "3 3"]
    seen: Bool[np.ndarray, "h w"]


def looked_by_arrays(camera: Camera, view: RunView) -> dict[str, np.ndarray]:
    """As `put_state` takes it."""
    return {
        "intrinsics": np.asarray(camera.intrinsics, np.float64),
        "base_from_camera": np.asarray(camera.base_from_camera, np.float64),
        "size": np.array(camera.size, np.int64),
        "distortion": np.asarray(camera.lens.coefficients, np.float64),
        "distortion_model": np.array(camera.lens.model),
        "floor_from_view": np.asarray(view.floor_from_view, np.float64),
        "seen": np.asarray(view.seen, bool),
    }


def looked_by(kept: Mapping[str, np.ndarray]) -> LookedBy:
    """The same again."""
    height, width = kept["size"].tolist()
    model, distortion = str(kept["distortion_model"]), tuple(kept["distortion"].tolist())
    camera = CameraFile(kept["intrinsics"], kept["base_from_camera"], width, height, 1000.0, model, distortion)
    return LookedBy(camera, kept["floor_from_view"], kept["seen"])


def camera_file(camera: Camera) -> CameraFile:
    """What a file says of a camera."""
    intrinsics, pose = np.asarray(camera.intrinsics, np.float64), np.asarray(camera.base_from_camera, np.float64)
    distortion = tuple(np.asarray(camera.lens.coefficients, float).tolist())
    return CameraFile(intrinsics, pose, camera.width, camera.height, 1000.0, camera.lens.model, distortion)
