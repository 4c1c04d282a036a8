"""Duckietown's two files: the intrinsics are ROS's YAML; the extrinsics are a homography from the image to the floor.

The homography is of pixels rectified with the intrinsics' projection_matrix, and gives metres: x ahead, y left of the
wheels' axle.
"""

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.calibration.document import Document, open_document
from ebjax.io.calibration.kind import Kind
from ebjax.io.calibration.ros_yaml import looks_like_ros, ros_calibration
from ebjax.io.calibration.values import camera_matrix, member, numbers

NAME = "Duckietown extrinsics (with their intrinsics)"


def read_floor_homography(path: str | Path) -> Float[np.ndarray, "3 3"]:
    """Reads `homography` of an extrinsics file: floor = H (x, y, 1) / w, m, of pixels rectified with P.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: no key `homography`, not 9 finite numbers, or no inverse.
    """
    document = open_document(path)
    homography = np.array(numbers(document.path, *member(document.path, document.values, "homography"), 9))
    homography = homography.reshape(3, 3)
    if np.linalg.matrix_rank(homography) < 3:
        raise ValueError(f"{path}: 'homography' has no inverse; calibrate the extrinsics again")
    return homography


def read_duckietown(intrinsics: str | Path, extrinsics: str | Path) -> Calibration:
    """Reads both files; `floor_from_image` is H P K^-1, so that it is of rectified pixels of K.

    Raises:
      FileNotFoundError: a file is not there.
      ValueError: a fault in one of the files; names it.
    """
    document = open_document(intrinsics)
    if not looks_like_ros(document):
        raise ValueError(f"{intrinsics}: not the YAML of intrinsics; give the file with camera_matrix")
    found = ros_calibration(document.path, document.values, None)
    rows = numbers(document.path, *member(document.path, document.values, "projection_matrix"), 12)
    p = camera_matrix(document.path, "projection_matrix", np.array(rows).reshape(3, 4)[:, :3].tolist())
    floor_from_image = read_floor_homography(extrinsics) @ p @ np.linalg.inv(found.intrinsics)
    return dataclasses.replace(found, kind="Duckietown intrinsics and extrinsics", floor_from_image=floor_from_image)


def _refuse(document: Document) -> Calibration:
    raise ValueError(
        f"{document.path}: Duckietown's extrinsics, a homography without a camera matrix; give the intrinsics file "
        "as the calibration, and this one beside it"
    )


def _recognises(document: Document) -> bool:
    return "homography" in document.values and "camera_matrix" not in document.values


KIND = Kind(NAME, _recognises, _refuse)
