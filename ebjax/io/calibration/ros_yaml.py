"""The YAML of ROS's camera_calibration: K and D of the raw image. R and P are for its rectification, not used here."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.calibration.camera_info import calibration_from_camera_info
from ebjax.io.calibration.document import Document
from ebjax.io.calibration.kind import Kind
from ebjax.io.calibration.values import image_size, member, numbers

NAME = "ROS camera_info YAML"
MARKS = {"camera_matrix", "distortion_coefficients", "rectification_matrix", "projection_matrix", "distortion_model"}


def looks_like_ros(document: Document) -> bool:
    """Whether the keys are those of ROS's calibration file."""
    found = MARKS & set(document.values)
    return len(found) >= 2 and bool(found & {"rectification_matrix", "projection_matrix", "distortion_model"})


def ros_calibration(
    path: Path, values: Mapping[str, Any], size: tuple[int, int] | None, kind: str = NAME
) -> Calibration:
    """The calibration of the file's keys; a lens whose name is missing goes by the number of its coefficients.

    Raises:
      ValueError: a key that is missing, or a matrix of the wrong size; names file and key.
    """
    (width, height), notes = image_size(path, values, [("image_width", "image_height")], size)
    fields = {"width": width, "height": height, "distortion_model": values.get("distortion_model")}
    fields["K"] = numbers(path, *member(path, values, "camera_matrix"), 9)
    fields["D"] = numbers(path, *member(path, values, "distortion_coefficients"))
    for name, count in (("rectification_matrix", 9), ("projection_matrix", 12)):
        if values.get(name) is not None:
            numbers(path, name, values[name], count)
    found = calibration_from_camera_info(path, fields, kind)
    return dataclasses.replace(found, notes=(*notes, *found.notes))


KIND = Kind(NAME, looks_like_ros, lambda document: ros_calibration(document.path, document.values, document.size))
