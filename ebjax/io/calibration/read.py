"""Reads a camera's calibration from a file of any known kind, recognised by what is in it."""

from pathlib import Path

from ebjax.geometry.lens_models import lens_fault
from ebjax.io.calibration import (
    camera_info,
    camera_json,
    camodocal,
    colmap,
    duckietown,
    euroc,
    gyroflow,
    kalibr,
    opencv_file,
    orbslam,
    realsense,
    ros_yaml,
    rtabmap,
    videre,
)
from ebjax.io.calibration.calibration import Calibration, implausible
from ebjax.io.calibration.document import open_document

KINDS = (
    colmap.KIND,
    videre.KIND,
    camera_info.KIND,
    realsense.KIND,
    camera_json.KIND,
    gyroflow.KIND,
    duckietown.KIND,
    kalibr.KIND,
    euroc.KIND,
    orbslam.KIND,
    camodocal.KIND,
    rtabmap.KIND,
    ros_yaml.KIND,
    opencv_file.KIND,
)
"""Asked in this order: the more particular kind first."""


def read_calibration(
    path: str | Path, *, camera: str | None = None, size: tuple[int, int] | None = None
) -> Calibration:
    """Reads a calibration file.

    Args:
      path: the file; its name does not matter.
      camera: which one, where the file has several (cam1 of Kalibr, an id of COLMAP, color of RealSense).
      size: width and height of the images, px, used only where the file says none.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: no known kind, or a fault in the values; names file, key or line, and the remedy.
    """
    document = open_document(path, camera=camera, size=size)
    kind = next((kind for kind in KINDS if kind.recognises(document)), None)
    if kind is None:
        said = f"{document.faults[0]}; not read as" if document.faults else "not recognised as"
        raise ValueError(
            f"{path}: {said} a camera's calibration; these are read: {', '.join(kind.name for kind in KINDS)}"
        )
    if camera is not None and not kind.several:
        raise ValueError(f"{path}: a {kind.name} of one camera; do not name a camera ({camera!r})")
    found = kind.read(document)
    if fault := lens_fault(found.distortion_model, found.distortion):
        raise ValueError(f"{path}: {fault}; correct it")
    if fault := implausible(found, cut=kind is camera_info.KIND):
        raise ValueError(f"{found.source}: {fault}")
    return found
