"""The camera of a run: from its log or a calibration file, and mounted as either or the user says."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.calibration.mount_file import read_mount
from ebjax.io.calibration.read import read_calibration
from ebjax.io.camera_file import CameraFile
from ebjax.io.images import BrokenFrame, same_shape
from ebjax.io.logs.lacking import refusal
from ebjax.io.logs.log import Log
from ebjax.io.logs.mount_options import MOUNT, NOTHING, MountOptions


def camera_of(log: Log, file: Path | None = None, mount: MountOptions = NOTHING) -> tuple[CameraFile, tuple[str, ...]]:
    """The camera of a log's images, by a calibration file where one is given, and as the user says it is mounted.

    Returns:
      The camera, and what the user should know of how it was read, a line each.

    Raises:
      ValueError: nothing says what the camera is or how it is mounted, or it is not this log's camera.
    """
    camera = calibration_of(log, file, mount)
    if camera is None:
        raise ValueError(refusal(log, mount))
    return mounted(camera), camera.notes


def calibration_of(log: Log, file: Path | None = None, mount: MountOptions = NOTHING) -> Calibration | None:
    """The calibration in a file, or the log's own, at the size of the log's images; None where there is neither.

    Its mount is as the user says; else as the file of the mount, the calibration or the log says, or None.

    Raises:
      ValueError: a file that cannot be read, or images of another shape; names both sizes.
    """
    if file is None and log.camera is None:
        return None
    sizes = log.colour.sizes or (_size(log),)
    camera = log.camera if file is None else read_calibration(file, size=sizes[0])
    assert camera is not None
    camera = _at_one_of(camera, sizes)
    fallback = log.base_from_camera if log.camera is None else log.camera.base_from_camera
    depth_scale = None if log.camera is None else log.camera.depth_scale
    camera = dataclasses.replace(camera, depth_scale=camera.depth_scale or depth_scale)
    return _as_mounted(camera, file, mount, fallback)


def camera_in(file: Path, sizes: Sequence[tuple[int, int]], mount: MountOptions = NOTHING) -> CameraFile:
    """The camera in a calibration file, at the size of images and mounted as the file or the user says.

    Args:
      file: the calibration.
      sizes: (width, height) that the images can be read at: the first that has the camera's shape is taken.
      mount: where the user says that the camera sits.

    Raises:
      ValueError: a file that cannot be read, images of another shape, or nothing says how the camera is mounted.
    """
    return mounted(_as_mounted(_at_one_of(read_calibration(file, size=sizes[0]), sizes), file, mount, None))


def _at_one_of(camera: Calibration, sizes: Sequence[tuple[int, int]]) -> Calibration:
    own = camera.width, camera.height
    return camera.scaled(*next((size for size in sizes if same_shape(own, size)), sizes[0]))


def mounted(camera: Calibration) -> CameraFile:
    """The camera that a calibration with its mount describes.

    Raises:
      ValueError: it says nothing of the mount; says what to measure.
    """
    if camera.base_from_camera is None:
        raise ValueError(f"{camera.source}: nothing says how the camera is mounted; {MOUNT}")
    return CameraFile(
        intrinsics=camera.intrinsics,
        base_from_camera=camera.base_from_camera,
        width=camera.width,
        height=camera.height,
        depth_scale=camera.depth_scale or 1000.0,
        distortion_model=camera.distortion_model,
        distortion=camera.distortion,
    )


def _as_mounted(
    camera: Calibration, file: Path | None, mount: MountOptions, fallback: Float[np.ndarray, "4 4"] | None
) -> Calibration:
    known, notes = (camera.base_from_camera, ()) if mount.file is None else read_mount(mount.file, file)
    pose = mount.pose(fallback if known is None else known)
    return dataclasses.replace(camera, base_from_camera=pose, notes=(*camera.notes, *notes))


def _size(log: Log) -> tuple[int, int]:
    if log.camera is not None:
        return log.camera.width, log.camera.height
    first = ""
    for k in range(len(log.colour)):
        try:
            height, width = log.colour.decode(k).shape[:2]
        except BrokenFrame as fault:
            first = first or str(fault)
            continue
        return width, height
    raise ValueError(f"{log.colour.source}: none of {len(log.colour)} images can be decoded; first {first}")
