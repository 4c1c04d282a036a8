"""The floor as one picture: every floor view is laid where its pose says and blended, sharpest view centre first.

Host-side (NumPy and OpenCV), one view in memory at a time. Map pixel (column, row) has its centre at
x = x_min + (column + 0.5) metres_per_px, y = y_max - (row + 0.5) metres_per_px.
"""

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from ebjax.geometry.planar import matrix

SHARPNESS = 4
MAX_PIXELS = 10_000_000


@dataclass(frozen=True)
class FloorMap:
    """A picture of the floor from above.

    Attributes:
      image: RGBA; alpha is 0 where no view saw the floor.
      extent: x_min, x_max, y_min, y_max of the image's outer edges in the world, m.
      metres_per_px: of the image.
    """

    image: UInt8[np.ndarray, "H W 4"]
    extent: tuple[float, float, float, float]
    metres_per_px: float


def closeness(mask: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Weight of a view's pixels: 1 in its centre, falling as (1 - r / r_corner)^4, 0 outside the mask."""
    height, width = mask.shape
    y, x = np.mgrid[:height, :width].astype(np.float32)
    x, y = x - (width - 1) / 2, y - (height - 1) / 2
    radius = np.hypot(x, y) / np.hypot(width / 2, height / 2)
    return np.where(mask, (1 - radius) ** SHARPNESS, 0).astype(np.float32)


def mosaic(
    views: Iterable[UInt8[np.ndarray, "h w 3"]],
    mask: Bool[np.ndarray, "h w"],
    floor_from_view: Float[np.ndarray, "... 3 3"],
    world_from_base: Float[np.ndarray, "N 3"],
    *,
    masks: Iterable[Bool[np.ndarray, "h w"]] | None = None,
    metres_per_px: float = 0.02,
) -> FloorMap:
    """Weighted mean of all views over every map pixel.

    Args:
      views: N floor views in the order of the poses; a generator keeps memory small.
      mask: pixels of a view that the camera sees.
      floor_from_view: view pixel (u, v, 1) -> (x, y, 1) in base, m; of all views, or of each.
      world_from_base: x, y (m) and heading (rad) of every view.
      masks: of each view, pixels that show floor and not a wall, where that is known (from depth).
      metres_per_px: of the map; made coarser where the map would exceed MAX_PIXELS.

    Raises:
      ValueError: no view, an empty mask, or not as many views as poses.
    """
    if not len(world_from_base) or not mask.any():
        raise ValueError("the floor map needs at least one view with a mask that is not empty")
    world_from_view = matrix(world_from_base) @ floor_from_view
    corners = _corners(mask, world_from_view)
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    scale = max(metres_per_px, math.sqrt(float(np.prod(high - low)) / MAX_PIXELS))
    columns, rows = (max(1, math.ceil(side / scale)) for side in high - low)
    map_from_world = np.array(
        [[1 / scale, 0, -low[0] / scale - 0.5], [0, -1 / scale, high[1] / scale - 0.5], [0, 0, 1]]
    )

    # Views finer than the map are averaged down first: sampling them would alias.
    view_scale = math.sqrt(np.abs(np.linalg.det(floor_from_view[..., :2, :2])).mean())
    shrink = min(max(1, round(scale / view_scale)), *mask.shape)
    view_from_small = np.array([[shrink, 0, (shrink - 1) / 2], [0, shrink, (shrink - 1) / 2], [0, 0, 1]])
    height, width = (side // shrink * shrink for side in mask.shape)
    weight = closeness(mask)[:height, :width, None]

    # Colour times weight, and the weight: one warp moves both.
    total = np.zeros((rows, columns, 4), np.float32)
    every = itertools.repeat(mask, len(corners)) if masks is None else masks
    for view, floor, pose, box in zip(views, every, world_from_view, corners, strict=True):
        seen_weight = weight * floor[:height, :width, None]
        premultiplied = np.concatenate([seen_weight * view[:height, :width], seen_weight], axis=-1)
        small = cv2.resize(premultiplied, (width // shrink, height // shrink), interpolation=cv2.INTER_AREA)
        map_from_small = map_from_world @ pose @ view_from_small
        _add(total, small, map_from_small, (box @ map_from_world[:2, :2].T) + map_from_world[:2, 2])
    seen = total[..., 3:] > 1e-6
    colour = np.where(seen, total[..., :3] / np.maximum(total[..., 3:], 1e-6), 0)
    image = np.concatenate([np.rint(colour), 255 * seen], axis=-1).clip(0, 255).astype(np.uint8)
    x_min, y_max = float(low[0]), float(high[1])
    return FloorMap(image, (x_min, x_min + columns * scale, y_max - rows * scale, y_max), scale)


def _corners(mask: Bool[np.ndarray, "h w"], world_from_view: Float[np.ndarray, "N 3 3"]) -> Float[np.ndarray, "N 4 2"]:
    """Where the corners of the mask's bounding box fall in the world."""
    (top, bottom), (left, right) = (np.flatnonzero(mask.any(axis=axis))[[0, -1]] for axis in (1, 0))
    box = np.array([[u, v, 1.0] for u in (left - 0.5, right + 0.5) for v in (top - 0.5, bottom + 0.5)])
    world = np.einsum("nij,kj->nki", world_from_view, box)
    return world[..., :2] / world[..., 2:]


def _add(
    total: Float[np.ndarray, "H W 4"],
    view: Float[np.ndarray, "h w 4"],
    map_from_view: Float[np.ndarray, "3 3"],
    box: Float[np.ndarray, "4 2"],
) -> None:
    """Adds a warped view to the part of the map that its box covers, in place."""
    rows, columns, _ = total.shape
    left, top = np.maximum(np.floor(box.min(axis=0)).astype(int), 0)
    right, bottom = np.minimum(np.ceil(box.max(axis=0)).astype(int) + 1, [columns, rows])
    if right <= left or bottom <= top:
        return
    part_from_map = np.array([[1.0, 0.0, -left], [0.0, 1.0, -top], [0.0, 0.0, 1.0]])
    size = (int(right - left), int(bottom - top))
    total[top:bottom, left:right] += cv2.warpPerspective(
        view, part_from_map @ map_from_view, size, flags=cv2.INTER_LINEAR
    )
