"""Depth from image files: float32 HW in metres along the optical axis, 0 = missing."""

import math
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from ebjax.io.camera_file import CameraFile
from ebjax.io.images import BrokenFrame, check_size, read_stored, same_shape

NO_DEPTH = 65535


def depth_values(path: str | Path) -> np.ndarray:
    """The numbers of a depth image as they are stored, H x W, uint16 or float; missing ones are 0.

    Zero, 65535 (what some sensors write where they see nothing), negative, NaN and infinite values are missing.

    Raises:
      BrokenFrame: unreadable, or not one channel of 16-bit or float depth; says what it is.
    """
    path = Path(path)
    values = read_stored(path, cv2.IMREAD_UNCHANGED)[0]
    if values.ndim != 2 or values.dtype not in (np.uint16, np.float32, np.float64):
        channels = 1 if values.ndim == 2 else values.shape[2]
        drawn = "; a picture of depth in colours has lost its metres" if channels > 2 else ""
        raise BrokenFrame(
            f"{path}: {channels} channel(s) of {values.dtype}; depth is one channel of 16 bits, or of floats in metres"
            f"{drawn}"
        )
    missing = values == NO_DEPTH
    if values.dtype != np.uint16:
        missing |= ~(np.isfinite(values) & (values > 0))
    values[missing] = 0
    return values


def units_per_metre(values: np.ndarray, depth_scale: float) -> float:
    """What to divide values by: `depth_scale`; floats by 1 if they are metres by themselves.

    Floats are metres (REP 118) unless dividing brings their median nearer to one metre, in ratio.
    """
    if values.dtype == np.uint16 or not (values > 0).any():
        return depth_scale
    median = float(np.median(values[values > 0]))
    return 1.0 if abs(math.log(median)) <= abs(math.log(median / depth_scale)) else depth_scale


def read_depth(path: str | Path, depth_scale: float, size: tuple[int, int] | None = None) -> Float[np.ndarray, "H W"]:
    """Reads depth along the optical axis, float32 metres; 0 means missing. See `depth_values` and `units_per_metre`.

    Args:
      path: 16-bit PNG or TIFF, or a float TIFF.
      depth_scale: file units per metre (1000 for millimetres).
      size: (width, height) that it must have.

    Raises:
      BrokenFrame: unreadable, no depth, or another size; names the file.
    """
    values = depth_values(path)
    check_size(path, values, size)
    return values.astype(np.float32) / np.float32(units_per_metre(values, depth_scale))


def fitted_depth(name: str, depth_m: Float[np.ndarray, "h w"], size: tuple[int, int]) -> Float[np.ndarray, "H W"]:
    """Depth at the (width, height) of the image it belongs to: the nearest of its values where the sizes differ.

    Raises:
      BrokenFrame: it has another shape than the image; gives its name.
    """
    height, width = depth_m.shape
    if (width, height) == size:
        return depth_m
    if not same_shape((width, height), size):
        raise BrokenFrame(f"{name}: {width}x{height} pixels, another shape than the camera's {size[0]}x{size[1]}")
    return cv2.resize(depth_m, size, interpolation=cv2.INTER_NEAREST_EXACT)  # type: ignore[return-value]


def depth_share(depth_m: Float[np.ndarray, "H W"]) -> float:
    """Returns the share of pixels that have depth (finite and above zero), in [0, 1]."""
    return float(np.mean(np.isfinite(depth_m) & (depth_m > 0)))


def read_depths(a: Path, b: Path, camera: CameraFile) -> tuple[Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
    """Reads two depth images of one camera.

    Raises:
      ValueError: an unreadable file, another size than the camera's, or no depth in it at all.
    """
    depths = []
    for path in (a, b):
        depth = read_depth(path, camera.depth_scale, (camera.width, camera.height))
        if depth_share(depth) == 0:
            raise ValueError(f"{path}: no pixel has depth; check the file and depth_scale, or leave the depth out")
        depths.append(depth)
    return depths[0], depths[1]
