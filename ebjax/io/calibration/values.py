"""Single values of a calibration file: numbers, matrices, sizes. Every fault names file, key and remedy."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

MOST, MOST_PX = 1e300, 1_000_000
"""Larger numbers, infinity too, are no values of a camera; larger images are none."""


def member(path: Path, values: Mapping[str, Any], *keys: str, prefix: str = "") -> tuple[str, Any]:
    """Finds the first of several keys that mean the same; returns its full name and its value."""
    for key in keys:
        if values.get(key) is not None:
            return prefix + key, values[key]
    raise ValueError(f"{path}: no key {prefix + keys[0]!r}; add it, or give the whole calibration file")


def shown(value: Any) -> str:
    """A value or a name in a message: cut, and in quotes where it is not one line of letters."""
    words = str(value)[:40]
    return words if words.isprintable() else repr(words)


def section(path: Path, values: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """The mapping under a key; empty where the key is not there."""
    found = values.get(key)
    if found is not None and not isinstance(found, Mapping):
        raise ValueError(f"{path}: {key!r} is {shown(found)}, not a section with keys of its own; correct it")
    return found or {}


def number(path: Path, key: str, value: Any, *, positive: bool = False) -> float:
    """One finite number; quoted ones and 1e-5 (a word to YAML) too."""
    if isinstance(value, str):
        try:
            value = float(value)
        except ValueError:
            raise ValueError(f"{path}: {key!r} is {value[:40]!r}, not a number; correct it") from None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{path}: {key!r} is {shown(value)}, not a number; correct it")
    if abs(value) > MOST or math.isnan(value) or (positive and value <= 0):
        raise ValueError(f"{path}: {key!r} is {shown(value)}, not a finite {'positive ' * positive}number; correct it")
    return float(value)


def _flat(value: Any) -> list[Any]:
    if isinstance(value, str) and len(value.replace(",", " ").split()) > 1:
        return list(value.replace(",", " ").split())
    return [leaf for part in value for leaf in _flat(part)] if isinstance(value, list | tuple) else [value]


def numbers(path: Path, key: str, value: Any, count: int | None = None) -> list[float]:
    """Numbers of a list, of rows, or of a mapping of `rows`, `cols` and `data`."""
    if isinstance(value, Mapping):
        key, data = member(path, value, "data", prefix=f"{key}.")
        shape = [whole(path, key, value[side]) if value[side] else 0 for side in ("rows", "cols") if side in value]
        if len(shape) == 2 and math.prod(shape) != len(_flat(data)):
            raise ValueError(f"{path}: {key!r} has {len(_flat(data))} numbers, not {shape[0]} x {shape[1]}; correct it")
        value = data
    if not isinstance(value, list | tuple | str):
        raise ValueError(f"{path}: {key!r} is {shown(value)}, not a list of numbers; correct it")
    found = [number(path, key, leaf) for leaf in _flat(value)]
    if count is not None and len(found) != count:
        raise ValueError(f"{path}: {key!r} has {len(found)} numbers, not {count}; correct it")
    return found


def whole(path: Path, key: str, value: Any) -> int:
    """A positive whole number of pixels; 640.0 too."""
    found = number(path, key, value, positive=True)
    if found != int(found) or found > MOST_PX:
        raise ValueError(f"{path}: {key!r} is {found:g}, not a whole number of pixels; correct it")
    return int(found)


def intrinsics_from(path: Path, keys: Sequence[str], values: Sequence[Any]) -> Float[np.ndarray, "3 3"]:
    """K of fx, fy, cx, cy."""
    fx, fy = (number(path, key, value, positive=True) for key, value in zip(keys[:2], values[:2], strict=True))
    cx, cy = (number(path, key, value) for key, value in zip(keys[2:], values[2:], strict=True))
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def camera_matrix(path: Path, key: str, value: Any) -> Float[np.ndarray, "3 3"]:
    """K as a 3 x 3 matrix: fx skew cx, 0 fy cy, 0 0 1."""
    k = np.array(numbers(path, key, value, 9)).reshape(3, 3)
    if np.allclose(k[:, 2], [0, 0, 1]) and k[2, :2].any():
        raise ValueError(f"{path}: {key!r} is transposed; write its rows as fx 0 cx, 0 fy cy, 0 0 1")
    if not np.allclose(k[2], [0, 0, 1]) or abs(k[1, 0]) > 1e-9:
        raise ValueError(f"{path}: {key!r} is {k.tolist()}, no camera matrix; its rows must be fx 0 cx, 0 fy cy, 0 0 1")
    if min(k[0, 0], k[1, 1]) <= 0:
        raise ValueError(f"{path}: {key!r} has the focal lengths {k[0, 0]} and {k[1, 1]}, not positive; correct it")
    return k


def image_size(
    path: Path,
    values: Mapping[str, Any],
    keys: Sequence[tuple[str, ...]],
    size: tuple[int, int] | None,
    prefix: str = "",
) -> tuple[tuple[int, int], tuple[str, ...]]:
    """Width and height by the first of `keys` that is there: two keys, or one of a pair; else `size`, with a note."""
    present = [[name for name in names if values.get(name) is not None] for names in keys]
    names = next((found for found, names in zip(present, keys, strict=True) if len(found) == len(names)), ())
    if names:
        pair = [values[name] for name in names]
        if len(names) == 1:
            sides = pair[0]
            if isinstance(sides, Mapping) and set(sides) == {"width", "height"}:
                sides = [sides["width"], sides["height"]]
            names, pair = names * 2, numbers(path, prefix + names[0], sides, 2)
        width, height = (whole(path, prefix + name, side) for name, side in zip(names, pair, strict=True))
        return (width, height), ()
    if size is not None and not any(present):
        return size, (f"{path}: no image size; taken as that of the images, {size[0]} x {size[1]} px",)
    wanted = next((names for found, names in zip(present, keys, strict=True) if found), keys[0])
    missing = " and ".join(repr(prefix + name) for name in wanted if values.get(name) is None)
    raise ValueError(f"{path}: no image size; add {missing}, in pixels, of the images that were calibrated")
