"""The camera of a run: from its log or a calibration file, and mounted as either or the user says."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ebjax.geometry.mount_numbers import mount_of, pose_of
from ebjax.io.calibration.calibration import Calibration
from ebjax.io.calibration.read import read_calibration
from ebjax.io.camera_file import CameraFile
from ebjax.io.logs.log import Log

MOUNT = (
    "measure and give --mount.height-m (of the lens above the floor) and --mount.pitch-deg (how far it looks down), "
    "and --mount.x-m (of the lens ahead of base_link) where it is not 0"
)


@dataclass(frozen=True)
class MountOptions:
    """Where the camera sits on the robot, where its calibration or log does not say, or says it wrong."""

    height_m: float | None = None
    """Of the lens above the floor, m."""
    pitch_deg: float | None = None
    """How far the optical axis looks down, degrees."""
    roll_deg: float | None = None
    """Turn about the optical axis, clockwise seen from behind the camera, degrees."""
    yaw_deg: float | None = None
    """Turn of the camera to the left, degrees; 180 looks back."""
    x_m: float | None = None
    """Of the lens ahead of base_link, m."""
    y_m: float | None = None
    """Of the lens to the left of base_link, m."""

    def pose(self, known: Float[np.ndarray, "4 4"] | None) -> Float[np.ndarray, "4 4"] | None:
        """base_from_camera: what is known of it, with what is given here in its place; None where that is too little.

        Raises:
          ValueError: a height that is not above the floor.
        """
        given = [self.pitch_deg, self.roll_deg, self.yaw_deg, self.height_m, self.x_m, self.y_m]
        if all(value is None for value in given):
            return known
        if self.height_m is not None and not self.height_m > 0:
            raise ValueError(f"mount.height_m is {self.height_m}: give the height of the lens above the floor, m")
        if known is None and (self.height_m is None or self.pitch_deg is None):
            return None
        start = np.zeros(6) if known is None else mount_of(known)
        scales = np.array([np.pi / 180] * 3 + [1.0] * 3)
        return pose_of(np.array([s if v is None else v * k for s, v, k in zip(start, given, scales, strict=True)]))


NOTHING = MountOptions()


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
    if log.camera is not None:
        size = log.camera.width, log.camera.height
    else:
        height, width = log.colour.decode(0).shape[:2]
        size = width, height
    return read_calibration(file, size=size).scaled(*size)


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
    known = camera.base_from_camera
    if known is None and log.camera is not None:
        known = log.camera.base_from_camera
    if (pose := mount.pose(known)) is None:
        raise ValueError(f"{camera.source}: nothing says how the camera is mounted; {MOUNT}")
    scale = camera.depth_scale or (log.camera.depth_scale if log.camera is not None else None)
    return CameraFile(
        intrinsics=camera.intrinsics,
        base_from_camera=pose,
        width=camera.width,
        height=camera.height,
        depth_scale=scale or 1000.0,
        distortion_model=camera.distortion_model,
        distortion=camera.distortion,
    )
