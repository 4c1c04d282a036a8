"""Intrinsics of librealsense saved as JSON: width, height, fx, fy, ppx, ppy, model, coeffs, at any depth."""

from typing import Any

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.calibration.document import Document
from ebjax.io.calibration.kind import Kind, choose
from ebjax.io.calibration.lens import lens, plain_name
from ebjax.io.calibration.values import image_size, intrinsics_from, member, numbers

NAME = "RealSense JSON"
NUMBERED = ("none", "modified_brown_conrady", "inverse_brown_conrady", "ftheta", "brown_conrady", "kannala_brandt4")
"""librealsense's rs2_distortion, in the order of its numbers."""


def _streams(values: Any, name: str = "") -> dict[str, dict[str, Any]]:
    if not isinstance(values, dict | list):
        return {}
    if isinstance(values, dict) and {"ppx", "ppy"} <= set(values):
        return {name: values}
    parts = values.items() if isinstance(values, dict) else enumerate(values)
    return {
        found: stream for key, value in parts for found, stream in _streams(value, f"{name}/{key}".strip("/")).items()
    }


def _read(document: Document) -> Calibration:
    path, streams = document.path, _streams(document.values)
    colour = [name for name in streams if name.lower().rpartition("/")[2] in ("color", "colour", "rgb")]
    name, notes = choose(path, list(streams), document.camera, colour[0] if colour else None)
    values, prefix = streams[name], f"{name}." if name else ""
    keys = ("fx", "fy", "ppx", "ppy")
    k = intrinsics_from(
        path, [prefix + key for key in keys], [member(path, values, key, prefix=prefix)[1] for key in keys]
    )
    key, word = member(path, values, "model", "distortion_model", "distortion", prefix=prefix)
    if isinstance(word, int) and 0 <= word < len(NUMBERED):
        word = NUMBERED[word]
    coefficients = numbers(path, *member(path, values, "coeffs", "coefficients", prefix=prefix))
    word = plain_name(word)
    if word == "inverse_brown_conrady" and any(coefficients):
        notes += (
            f"{path}: {key} is inverse_brown_conrady with coefficients; taken as plumb_bob, which can be wrong by "
            "pixels at the corners; calibrate with ROS or Kalibr if that matters",
        )
    if not any(coefficients) and word in NUMBERED and word not in ("kannala_brandt4", "ftheta"):
        word = "none"
    model, distortion = lens(path, "plumb_bob" if word == "inverse_brown_conrady" else word, coefficients)
    (width, height), sized = image_size(path, values, [("width", "height")], document.size, prefix)
    return Calibration(str(path), NAME, width, height, k, model, distortion, notes=(*notes, *sized))


KIND = Kind(NAME, lambda document: bool(_streams(document.values)), _read, several=True)
