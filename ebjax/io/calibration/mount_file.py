"""How a camera is mounted, from a file of its own: Duckietown's homography, or any calibration that says it."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from ebjax.geometry.mount_numbers import pose_of_homography
from ebjax.io.calibration.document import open_document
from ebjax.io.calibration.duckietown import KIND, read_duckietown
from ebjax.io.calibration.read import read_calibration

MOST_STRETCH = 0.05
"""By which share a homography's lengths may differ from those of a rigid mount; one of other pixels differs by more."""


def read_mount(path: Path, intrinsics: Path | None) -> tuple[Float[np.ndarray, "4 4"], tuple[str, ...]]:
    """base_from_camera that a file says, and notes.

    Args:
      path: the file.
      intrinsics: the camera's calibration file, if there is one: a homography is of pixels that it rectifies.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: the file says nothing of a mount, or no rigid one; names it.
    """
    if not KIND.recognises(open_document(path)):
        found = read_calibration(path).base_from_camera
        if found is None:
            raise ValueError(f"{path}: says nothing of how the camera is mounted; give --mount.height-m and so on")
        return found, ()
    if intrinsics is None:
        raise ValueError(
            f"{path}: a homography of pixels that the intrinsics rectify; give their file too, as --camera FILE"
        )
    camera = read_duckietown(intrinsics, path)
    assert camera.floor_from_image is not None
    pose, stretch = pose_of_homography(camera.intrinsics, camera.floor_from_image)
    if stretch > MOST_STRETCH:
        raise ValueError(
            f"{path}: no rigid mount of the camera in {intrinsics} sees the floor by this homography (lengths are "
            f"{stretch:.0%} off); give the intrinsics that it was calibrated with"
        )
    return pose, (f"{path}: the mount is that of its homography, lengths on the floor within {stretch:.1%}",)
