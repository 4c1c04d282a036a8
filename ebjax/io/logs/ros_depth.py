"""Depth images of ROS messages as float32 metres: 16UC1 (mm), 32FC1 (m), and compressedDepth by PNG or RVL.

compressedDepth is int32, float A, float B, then a PNG, or columns, rows and RVL. 32FC1 is stored there as
v = A / z + B; v = 0 is missing.
"""

import struct

import cv2
import numpy as np
from jaxtyping import Float, Float32

from ebjax.io.depth_images import NO_DEPTH
from ebjax.io.images import PNG_SIGNATURE
from ebjax.io.logs import rvl
from ebjax.io.logs.ros_image import decoded, rows_from
from ebjax.io.logs.ros_message import COMPRESSED, Image

MILLIMETRES = ("16UC1", "mono16")
ENCODINGS = (*MILLIMETRES, "32FC1")
HEAD = 12


def _metres(values: np.ndarray) -> Float32[np.ndarray, "H W"]:
    if values.ndim != 2 or values.dtype not in (np.uint16, np.float32):
        raise ValueError(f"not depth: {values.dtype} of shape {values.shape}; depth is one channel of 16 bits or float")
    if values.dtype == np.uint16:
        return np.where(values != NO_DEPTH, values * np.float32(0.001), np.float32(0))
    return np.where(np.isfinite(values) & (values > 0), values, np.float32(0))


def _compressed(image: Image) -> Float32[np.ndarray, "H W"]:
    data = image.data
    if data[:8] == PNG_SIGNATURE:
        return _metres(decoded(data, cv2.IMREAD_UNCHANGED))
    if len(data) < HEAD + 8:
        raise ValueError("truncated depth")
    _, scale, shift = struct.unpack_from("<iff", data)
    if data[HEAD : HEAD + 8] == PNG_SIGNATURE:
        values = decoded(data[HEAD:], cv2.IMREAD_UNCHANGED)
    elif "rvl" in image.encoding.lower():
        width, height = struct.unpack_from("<II", data, HEAD)
        if width * height > 1 << 28:
            raise ValueError(f"damaged RVL depth of {width} x {height} px")
        values = rvl.decode(bytes(data[HEAD + 8 :]), width, height)
    else:
        raise ValueError(f"depth of format {image.encoding!r} is not known; record PNG or RVL")
    if not image.encoding.startswith("32FC1"):
        return _metres(values)
    present = (values > 0) & (values != shift)
    depth = np.float32(scale) / np.where(present, values.astype(np.float32) - np.float32(shift), np.float32(1))
    return _metres(np.where(present, depth, np.float32(0)))


def depth_from(image: Image, kind: str) -> Float32[np.ndarray, "H W"]:
    """A depth message in metres; 0, NaN and 65535 become 0.

    Raises:
      ValueError: truncated, or no depth.
    """
    if kind == COMPRESSED:
        return _compressed(image)
    if image.encoding not in ENCODINGS:
        raise ValueError(f"depth of encoding {image.encoding!r} is not known; known are {', '.join(ENCODINGS)}")
    dtype = np.dtype(np.uint16 if image.encoding in MILLIMETRES else np.float32)
    return _metres(rows_from(image, dtype, 1, image.height))


def registered(
    depth: Float[np.ndarray, "h w"],
    depth_intrinsics: Float[np.ndarray, "3 3"],
    colour_intrinsics: Float[np.ndarray, "3 3"],
    colour_size: tuple[int, int],
    colour_from_depth: Float[np.ndarray, "4 4"],
) -> Float32[np.ndarray, "H W"]:
    """Moves depth into the colour camera, both pinhole; the nearest of several points stays.

    The result has the colour camera's shape, scaled down to the depth's focal length, so that it has no gaps.

    Args:
      depth: m, 0 = missing.
      depth_intrinsics: px.
      colour_intrinsics: px.
      colour_size: width and height, px.
      colour_from_depth: between the optical frames, m.
    """
    share = min(1.0, float(depth_intrinsics[0, 0] / colour_intrinsics[0, 0]))
    width = max(round(colour_size[0] * share), 1)
    height = max(round(colour_size[1] * width / colour_size[0]), 1)
    scale = np.array([[width / colour_size[0]], [height / colour_size[1]]])
    focal = np.diag(colour_intrinsics)[:2, None] * scale
    centre = (colour_intrinsics[:2, 2:] + 0.5) * scale - 0.5
    v, u = np.nonzero(depth > 0)
    z = depth[v, u].astype(np.float64)
    rays = np.linalg.inv(depth_intrinsics) @ np.stack([u, v, np.ones(len(u))])
    points = colour_from_depth[:3, :3] @ (rays * z) + colour_from_depth[:3, 3:]
    points = points[:, points[2] > 0]
    column, row = np.rint(focal * points[:2] / points[2] + centre).astype(np.int64)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    nearest = np.full(width * height, np.inf, np.float32)
    np.minimum.at(nearest, (row * width + column)[inside], points[2, inside].astype(np.float32))
    return np.where(np.isfinite(nearest), nearest, np.float32(0)).reshape(height, width)
