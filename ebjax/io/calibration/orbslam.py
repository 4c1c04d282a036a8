"""The settings of ORB-SLAM2 and 3: Camera.fx or Camera1.fx, Camera.type, Camera.k1, ..."""

import re
from typing import Any

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.calibration.document import Document
from ebjax.io.calibration.kind import Kind, choose
from ebjax.io.calibration.lens import lens, plain_name, unnamed_lens
from ebjax.io.calibration.values import camera_matrix, image_size, intrinsics_from, member, number, numbers, shown

NAME = "ORB-SLAM settings"
COEFFICIENTS = {
    "pinhole": ("k1", "k2", "p1", "p2", "k3"),
    "kannalabrandt8": ("k1", "k2", "k3", "k4"),
    "rectified": (),
}
ANY = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")


def _cameras(values: dict[str, Any]) -> list[str]:
    """Camera, Camera1, Camera2; LEFT and RIGHT are the raw images of ORB-SLAM2's stereo settings."""
    names = {match[1] for key in values if (match := re.fullmatch(r"(Camera\d?)\.(fx|fy|cx|cy)", key))}
    return sorted(names) + [side for side in ("LEFT", "RIGHT") if f"{side}.K" in values]


def _number(document: Document, name: str, key: str) -> float:
    return number(document.path, f"{name}.{key}", document.values.get(f"{name}.{key}", 0.0))


def _read(document: Document) -> Calibration:
    path, values = document.path, document.values
    cameras = _cameras(values)
    name, notes = choose(path, cameras, document.camera)
    if name in ("LEFT", "RIGHT"):
        k = camera_matrix(path, f"{name}.K", values[f"{name}.K"])
        model, distortion, _ = unnamed_lens(path, numbers(path, *member(path, values, f"{name}.D")))
        sizes = [(f"{name}.width", f"{name}.height")]
    else:
        keys = [f"{name}.{key}" for key in ("fx", "fy", "cx", "cy")]
        k = intrinsics_from(path, keys, [member(path, values, key)[1] for key in keys])
        word = shown(values.get("Camera.type", "PinHole"))
        order = COEFFICIENTS.get(plain_name(word))
        if order is None:
            raise ValueError(f"{path}: 'Camera.type' {word!r} is not read; PinHole, KannalaBrandt8 and Rectified are")
        found = {key: _number(document, name, key) for key in ANY}
        if unused := [key for key in ANY if found[key] and key not in order]:
            raise ValueError(f"{path}: '{name}.{unused[0]}' is none of a {word} camera; correct it or 'Camera.type'")
        coefficients = [found[key] for key in order]
        fisheye = plain_name(word) == "kannalabrandt8"
        model, distortion = lens(path, "equidistant" if fisheye else "plumb_bob", coefficients)
        sizes = [("Camera.width", "Camera.height")]
        if "LEFT" in cameras:
            notes += (f"{path}: {name} is of the images that ORB-SLAM2 rectifies; for raw images choose LEFT",)
    (width, height), sized = image_size(path, values, sizes, document.size)
    factor = values.get("RGBD.DepthMapFactor", values.get("DepthMapFactor"))
    scale = None if factor is None else number(path, "DepthMapFactor", factor, positive=True)
    return Calibration(str(path), NAME, width, height, k, model, distortion, depth_scale=scale, notes=(*notes, *sized))


KIND = Kind(NAME, lambda document: bool(_cameras(document.values)), _read, several=True)
