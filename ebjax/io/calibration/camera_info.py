"""sensor_msgs/CameraInfo: the message's meaning, and its text as `rostopic echo` and `ros2 topic echo` print it.

K and D are those of the raw image at full resolution; binning and the region of interest lead to the image as sent.
R and P are for the rectification of that image and not used.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.calibration.document import Document
from ebjax.io.calibration.kind import Kind
from ebjax.io.calibration.lens import KNOWN, lens, plain_name, unnamed_lens
from ebjax.io.calibration.values import camera_matrix, member, number, numbers, section, whole

NAME = "CameraInfo printed by rostopic echo"


def _field(values: Mapping[str, Any], name: str) -> Any:
    """A field by its ROS 1 (upper case) or ROS 2 (lower case) name."""
    return values.get(name, values.get(name.lower()))


def _ros_lens(path: Path, name: Any, coefficients: list[float]) -> tuple[str, tuple[float, ...], tuple[str, ...]]:
    """ROS takes zeros for no distortion, whatever the lens's name."""
    if not name:
        return unnamed_lens(path, coefficients)
    if any(coefficients):
        return *lens(path, name, coefficients), ()
    fisheye = KNOWN.get(plain_name(name)) == "equidistant"
    note = f"{path}: an equidistant lens with coefficients of zero; taken as no distortion, as ROS does"
    return "pinhole", (), (note,) if fisheye else ()


def calibration_from_camera_info(path: Path, values: Mapping[str, Any], kind: str = NAME) -> Calibration:
    """Makes the calibration of a message, a mapping of its fields by ROS 1's or ROS 2's names.

    Raises:
      ValueError: a field that is missing, of the wrong size or not a number; a region outside the image.
    """
    width, height = (whole(path, *member(path, values, side)) for side in ("width", "height"))
    key, flat = member(path, values, *(("k", "K") if "k" in values else ("K",)))
    flat, notes = numbers(path, key, flat, 9), list[str]()
    coefficients = numbers(path, "D", _field(values, "D") or [])
    matrices = {n: numbers(path, n, _field(values, n) or [0] * count, count) for n, count in (("R", 9), ("P", 12))}
    if not any(flat) and not any(coefficients) and any(matrices["P"]):
        flat = np.array(matrices["P"]).reshape(3, 4)[:, :3].tolist()
        notes = [f"{path}: K is zero; P is used"]
    model, distortion, said = _ros_lens(path, values.get("distortion_model"), coefficients)
    k = camera_matrix(path, key, flat)
    whole_image = Calibration(str(path), kind, width, height, k, model, distortion, notes=(*notes, *said))
    return _as_sent(path, values, whole_image)


def _as_sent(path: Path, values: Mapping[str, Any], full: Calibration) -> Calibration:
    """Cuts out `roi`, then bins: a pixel is the mean of its block, x' = (x + 0.5) / b - 0.5."""
    roi = section(path, values, "roi")
    names = ("x_offset", "y_offset", "width", "height")
    x, y, across, down = (number(path, f"roi.{name}", roi.get(name, 0)) for name in names)
    across, down = across or full.width, down or full.height
    if min(x, y, across, down) < 0 or x + across > full.width or y + down > full.height:
        raise ValueError(f"{path}: 'roi' is outside the image of {full.width} x {full.height} px; correct it")
    bx, by = (whole(path, name, values.get(name) or 1) for name in ("binning_x", "binning_y"))
    width, height = int(across // bx), int(down // by)
    if (width, height) == (full.width, full.height):
        return full
    to_sent = np.array([[1 / bx, 0, (0.5 - x) / bx - 0.5], [0, 1 / by, (0.5 - y) / by - 0.5], [0, 0, 1]])
    note = (
        f"{path}: region {across:g} x {down:g} at ({x:g}, {y:g}) and binning {bx} x {by} of the full {full.width} x "
        f"{full.height} px are applied: {width} x {height} px"
    )
    return dataclasses.replace(
        full, width=width, height=height, intrinsics=to_sent @ full.intrinsics, notes=(*full.notes, note)
    )


def _is_message(values: Mapping[str, Any]) -> bool:
    named = sum(_field(values, name) is not None for name in "DKRP")
    return named >= 2 and bool({"header", "roi", "binning_x", "distortion_model"} & set(values))


def _read(document: Document) -> Calibration:
    path, zeros = document.path, 0
    for values in document.mappings():
        if not _is_message(values):
            continue
        if any(any(numbers(path, name, _field(values, name) or [0])) for name in "KP"):
            return calibration_from_camera_info(path, values)
        zeros += 1
    raise ValueError(f"{path}: all {zeros} messages are zero: the camera was not calibrated; give its calibration file")


KIND = Kind(NAME, lambda document: _is_message(document.values), _read)
