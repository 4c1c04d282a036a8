"""Kalibr's camchain: cam0, cam1, ... with a projection and a distortion. Its transforms are between camera and IMU."""

import dataclasses
import re
from pathlib import Path
from typing import Any

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.calibration.document import Document
from ebjax.io.calibration.kind import Kind, choose
from ebjax.io.calibration.lens import KNOWN, lens, plain_name
from ebjax.io.calibration.values import image_size, intrinsics_from, member, numbers

NAME = "Kalibr camchain"
TRANSFORMS = ("T_cam_imu", "T_imu_cam", "T_cn_cnm1", "T_BS", "T_B_S")


def projected(
    path: Path, kind: str, values: dict[str, Any], size: tuple[int, int] | None, prefix: str = ""
) -> Calibration:
    """A camera in Kalibr's terms: camera_model pinhole or omni (xi first), distortion_model, resolution.

    Raises:
      ValueError: another projection or lens, a key that is missing, a wrong count; names key and remedy.
    """
    projection = plain_name(values.get("camera_model") or "pinhole")
    if projection not in ("pinhole", "omni"):
        raise ValueError(
            f"{path}: {prefix}camera_model {projection!r} is not read; calibrate again with pinhole-radtan, "
            "pinhole-equi or omni-radtan"
        )
    key, intrinsics = member(path, values, "intrinsics", prefix=prefix)
    found = numbers(path, key, intrinsics, 5 if projection == "omni" else 4)
    k = intrinsics_from(path, [f"{key}[{index}]" for index in range(4)], found[-4:])
    _, word = member(path, values, "distortion_model", prefix=prefix)
    key, listed = (
        ("", [])
        if KNOWN.get(plain_name(word)) == "pinhole"
        else member(path, values, "distortion_coeffs", "distortion_coefficients", prefix=prefix)
    )
    coefficients = numbers(path, key, listed)
    if projection == "pinhole":
        model, distortion = lens(path, word, coefficients)
    elif KNOWN.get(plain_name(word)) in ("plumb_bob", "pinhole"):
        model, distortion = lens(path, "omnidirectional", [found[0], *(coefficients or [0.0] * 4)])
    else:
        raise ValueError(f"{path}: omni with {word!r} is not read; calibrate again with omni-radtan")
    (width, height), notes = image_size(path, values, [("resolution",)], size, prefix)
    if transforms := [name for name in TRANSFORMS if name in values]:
        notes += (f"{path}: {' and '.join(transforms)} not used: not the camera's place on the robot's base",)
    return Calibration(str(path), kind, width, height, k, model, distortion, notes=notes)


def _cameras(document: Document) -> list[str]:
    return [
        key for key, value in document.values.items() if re.fullmatch(r"(?i)cam\d+", key) and isinstance(value, dict)
    ]


def _read(document: Document) -> Calibration:
    name, notes = choose(document.path, _cameras(document), document.camera)
    found = projected(document.path, NAME, document.values[name], document.size, f"{name}.")
    return dataclasses.replace(found, notes=(*notes, *found.notes))


KIND = Kind(NAME, lambda document: bool(_cameras(document)), _read, several=True)
