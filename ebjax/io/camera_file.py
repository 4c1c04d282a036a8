"""camera.json: intrinsics, lens, image size, depth units and where the camera sits on the robot."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ebjax.geometry.lens_models import COUNTS, lens_fault, no_lens_if_straight
from ebjax.io.atomic import whole_file
from ebjax.io.json_text import read_json
from ebjax.io.poses import rigid_fault

KEYS = ("fx", "fy", "cx", "cy", "width", "height", "depth_scale", "T_base_camera")
LENS_KEYS = ("distortion_model", "D")
MOST = 1e300
"""Larger numbers, infinity too, are no values of a camera."""


@dataclass(frozen=True)
class CameraFile:
    """A calibrated camera on a robot.

    Attributes:
      intrinsics: K, px.
      base_from_camera: p_base = base_from_camera @ p_camera, metres; base x forward, y left, z up, floor z = 0;
        camera x right, y down, z forward.
      width: px.
      height: px.
      depth_scale: depth file units per metre.
      distortion_model: of the lens, a name in `geometry.lens_models`.
      distortion: its coefficients, in that order.
    """

    intrinsics: Float[np.ndarray, "3 3"]
    base_from_camera: Float[np.ndarray, "4 4"]
    width: int
    height: int
    depth_scale: float
    distortion_model: str = "pinhole"
    distortion: tuple[float, ...] = ()


def _number(path: Path, values: dict[str, Any], key: str, *, positive: bool) -> float:
    value = values[key]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{path}: {key!r} is {json.dumps(value)[:60]}, not a number; correct it")
    if abs(value) > MOST or math.isnan(value) or (positive and value <= 0):
        wanted = "finite positive number" if positive else "finite number"
        raise ValueError(f"{path}: {key!r} is {str(value)[:60]}, not a {wanted}; correct it")
    return float(value)


def _whole(path: Path, values: dict[str, Any], key: str) -> int:
    value = _number(path, values, key, positive=True)
    if value != int(value):
        raise ValueError(f"{path}: {key!r} is {value}, not a whole number of pixels; correct it")
    return int(value)


def _pose(path: Path, values: dict[str, Any], key: str) -> np.ndarray:
    rows = values[key]
    numeric = isinstance(rows, list) and all(
        isinstance(row, list)
        and len(row) == 4
        and all(isinstance(v, int | float) and not isinstance(v, bool) and abs(v) <= MOST for v in row)
        for row in rows
    )
    if not numeric or len(rows) != 4:
        raise ValueError(f"{path}: {key!r} is not 4 rows of 4 finite numbers; give p_base = T p_camera, metres")
    pose = np.array(rows, dtype=np.float64)
    if fault := rigid_fault(pose):
        raise ValueError(f"{path}: {key!r} is not a rigid transform: {fault}; give p_base = T p_camera, metres")
    return pose


def read_camera(path: str | Path, *, depth: bool = True) -> CameraFile:
    """Reads camera.json: fx fy cx cy width height (px), depth_scale (units per metre), T_base_camera (4x4, metres).

    A lens that bends is given by distortion_model (a name in `geometry.lens_models`) and D (its coefficients).

    Args:
      path: the file.
      depth: whether depth is going to be read; without it `depth_scale` may be left out.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: not JSON, a missing or unknown key, a wrong type, NaN, a transform that is not rigid, an unknown
        lens; names file and key.
    """
    path = Path(path)
    values = read_json(path, lambda pairs: _unique(path, pairs))
    if not isinstance(values, dict):
        raise ValueError(f"{path}: not a JSON object; it needs the keys {', '.join(KEYS)}")
    if not depth:
        values = {"depth_scale": 1000.0, **values}
    if missing := [key for key in KEYS if key not in values]:
        raise ValueError(f"{path}: no key {', '.join(map(repr, missing))}; it needs {', '.join(KEYS)}")
    if unknown := sorted(set(values) - {*KEYS, *LENS_KEYS}):
        known = ", ".join((*KEYS, *LENS_KEYS))
        raise ValueError(f"{path}: unknown key {', '.join(map(repr, unknown))}; known are {known}")
    fx, fy = (_number(path, values, key, positive=True) for key in ("fx", "fy"))
    cx, cy = (_number(path, values, key, positive=False) for key in ("cx", "cy"))
    model, distortion = _lens(path, values)
    return CameraFile(
        intrinsics=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        base_from_camera=_pose(path, values, "T_base_camera"),
        width=_whole(path, values, "width"),
        height=_whole(path, values, "height"),
        depth_scale=_number(path, values, "depth_scale", positive=True),
        distortion_model=model,
        distortion=distortion,
    )


def _unique(path: Path, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of which no key is there twice, for only the last would count."""
    values = dict(pairs)
    if len(values) < len(pairs):
        twice = next(key for key in values if [name for name, _ in pairs].count(key) > 1)
        raise ValueError(f"{path}: {twice!r} is there twice; remove one of the two")
    return values


def _lens(path: Path, values: dict[str, Any]) -> tuple[str, tuple[float, ...]]:
    present = [key for key in LENS_KEYS if key in values]
    if len(present) == 1:
        absent = next(key for key in LENS_KEYS if key not in values)
        raise ValueError(f"{path}: {present[0]!r} without {absent!r}; give both, or neither for undistorted images")
    if not present:
        return "pinhole", ()
    model, rows = values["distortion_model"], values["D"]
    if not isinstance(rows, list):
        raise ValueError(f"{path}: 'D' is {json.dumps(rows)[:60]}, not a list of numbers; correct it")
    distortion = tuple(_number(path, {"D": value}, "D", positive=False) for value in rows)
    if fault := lens_fault(str(model), distortion):
        raise ValueError(f"{path}: {'D' if str(model) in COUNTS else 'distortion_model'!r}: {fault}; correct it")
    return no_lens_if_straight(str(model), distortion)


def write_camera(path: str | Path, camera: CameraFile) -> None:
    """Writes the camera.json that `read_camera` reads, whole."""
    k = camera.intrinsics
    values: dict[str, Any] = {
        "width": camera.width,
        "height": camera.height,
        "fx": float(k[0, 0]),
        "fy": float(k[1, 1]),
        "cx": float(k[0, 2]),
        "cy": float(k[1, 2]),
        "depth_scale": camera.depth_scale,
        "T_base_camera": camera.base_from_camera.tolist(),
    }
    if camera.distortion_model != "pinhole":
        values |= {"distortion_model": camera.distortion_model, "D": list(camera.distortion)}
    with whole_file(path) as file:
        file.write(json.dumps(values, indent=1) + "\n")
