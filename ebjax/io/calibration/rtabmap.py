"""The YAML of RTAB-Map: ROS's keys in an OpenCV file, K not always right, the mount in `local_transform`.

RTAB-Map works on rectified images, to which P belongs; K and D tell of the images before. A file of its calibration
tool describes raw images.
"""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.calibration.document import Document
from ebjax.io.calibration.kind import Kind
from ebjax.io.calibration.ros_yaml import looks_like_ros, ros_calibration
from ebjax.io.calibration.values import camera_matrix, numbers
from ebjax.io.poses import rigid_fault

NAME = "RTAB-Map YAML"


def _recognises(document: Document) -> bool:
    """By OpenCV's header over ROS's keys: ROS itself writes no header, OpenCV itself a tag at each matrix."""
    written = document.text.lstrip().startswith("%YAML") and "!!opencv-matrix" not in document.text
    return looks_like_ros(document) and (written or "local_transform" in document.values)


def _rectified(path: Path, values: dict[str, Any]) -> tuple[dict[str, Any], tuple[str, ...]]:
    """The values with P's camera matrix in place of K where the lens bends nothing."""
    stated = numbers(path, "camera_matrix", values.get("camera_matrix") or [])
    if any(numbers(path, "distortion_coefficients", values.get("distortion_coefficients") or [])):
        note = (
            f"{path}: read as the calibration of raw images; those out of RTAB-Map's database are rectified already: "
            "for them write projection_matrix' values into camera_matrix, and zeros into distortion_coefficients"
        )
        return values, (note,)
    p = np.array(numbers(path, "projection_matrix", values.get("projection_matrix") or [0] * 12, 12)).reshape(3, 4)
    if not p.any() or np.array_equal(stated, p[:, :3].ravel()):
        return {"distortion_coefficients": [], **values}, ()
    k = camera_matrix(path, "projection_matrix", p[:, :3].tolist())
    copied = stated == p.ravel()[:9].tolist()
    why = "holds the first 9 numbers of projection_matrix" if copied else "differs from projection_matrix"
    note = f"{path}: camera_matrix {why}; projection_matrix is used, as RTAB-Map does"
    return {**values, "camera_matrix": k.tolist(), "distortion_coefficients": []}, (note,)


def _read(document: Document) -> Calibration:
    path = document.path
    values, notes = _rectified(path, document.values)
    found = ros_calibration(path, values, document.size, NAME)
    mount = None
    if values.get("local_transform") is not None:
        rows = np.array(numbers(path, "local_transform", values["local_transform"], 12)).reshape(3, 4)
        mount = np.vstack([rows, [0.0, 0.0, 0.0, 1.0]])
        if fault := rigid_fault(mount):
            raise ValueError(f"{path}: 'local_transform' is not a rigid transform: {fault}; correct it or leave it out")
        if not mount[:3, 3].any():
            mount, notes = None, (*notes, f"{path}: local_transform puts the camera at the base's origin; not used")
    return dataclasses.replace(found, base_from_camera=mount, notes=(*found.notes, *notes))


KIND = Kind(NAME, _recognises, _read)
