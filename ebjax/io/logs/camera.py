"""The camera of a run: from its log or a calibration file, and mounted as either or the user says."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.calibration.read import read_calibration
from ebjax.io.camera_file import CameraFile
from ebjax.io.images import BrokenFrame
from ebjax.io.logs.log import Log
from ebjax.io.logs.mount_options import MOUNT, NOTHING, MountOptions


def camera_of(log: Log, file: Path | None = None, mount: MountOptions = NOTHING) -> tuple[CameraFile, tuple[str, ...]]:
    """The camera of a log's images, by a calibration file where one is given, and as the user says it is mounted.

    Returns:
      The camera, and what the user should know of how it was read, a line each.

    Raises:
      ValueError: nothing says what the camera is or how it is mounted, or it is not this log's camera.
    """
    camera = log.camera if file is None else given_camera(log, file)
    return mounted(log, camera, mount), () if camera is None else camera.notes


def given_camera(log: Log, file: Path) -> Calibration:
    """The calibration in a file, at the size of the log's images."""
    size = _size(log) if log.camera is None else (log.camera.width, log.camera.height)
    return read_calibration(file, size=size).scaled(*size)


def camera_in(file: Path, size: tuple[int, int], mount: MountOptions = NOTHING) -> CameraFile:
    """The camera in a calibration file, at the (width, height) of images and mounted as the file or the user says.

    Raises:
      ValueError: a file that cannot be read, images of another shape, or nothing says how the camera is mounted.
    """
    return _mounted(read_calibration(file, size=size).scaled(*size), None, None, mount)


def _size(log: Log) -> tuple[int, int]:
    for k in range(len(log.colour)):
        try:
            height, width = log.colour.decode(k).shape[:2]
        except BrokenFrame:
            continue
        return width, height
    raise ValueError(f"{log.colour.source}: none of {len(log.colour)} images can be decoded; repair them")


def mounted(log: Log, camera: Calibration | None, mount: MountOptions = NOTHING) -> CameraFile:
    """The camera of a log's images.

    Args:
      log: the log.
      camera: its own, or one that was given in its place.
      mount: where the user says that it sits; else as the calibration says, else the log.

    Raises:
      ValueError: nothing says what the camera is, or how it is mounted; says what to give.
    """
    if camera is None:
        raise ValueError(
            f"{log.path}: {log.missing.get('camera', 'it says nothing of the camera: give --camera FILE')}"
        )
    known = log.base_from_camera if log.camera is None else log.camera.base_from_camera
    return _mounted(camera, known, log.camera.depth_scale if log.camera is not None else None, mount)


def _mounted(
    camera: Calibration, known: Float[np.ndarray, "4 4"] | None, depth_scale: float | None, mount: MountOptions
) -> CameraFile:
    own = camera.base_from_camera
    if (pose := mount.pose(known if own is None else own)) is None:
        raise ValueError(f"{camera.source}: nothing says how the camera is mounted; {MOUNT}")
    return CameraFile(
        intrinsics=camera.intrinsics,
        base_from_camera=pose,
        width=camera.width,
        height=camera.height,
        depth_scale=camera.depth_scale or depth_scale or 1000.0,
        distortion_model=camera.distortion_model,
        distortion=camera.distortion,
    )
