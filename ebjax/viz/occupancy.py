"""Which cells of the floor are free, and where something stands, by the votes of all views.

A view is read along rays over the floor from the camera's foot. Depth marks what rises above the floor by a threshold,
which on the front of an object is some way up: the floor view shows that point behind the object's foot. The foot is
where the ray is at the threshold's height, and what a ray shows from there on is no floor.
"""

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from ebjax.slam.map import FloorMap
from ebjax.views.floor_view import OBSTACLE_M

UNKNOWN, FREE, OCCUPIED = -1, 0, 100
"""As in nav_msgs/OccupancyGrid."""
SAMPLES_A_CELL = 1.5
"""Along and across the rays: every cell that a view shows is met."""
GRAZING = 4
"""Samples. What begins to hide the floor so much behind where it did on the next ray is seen along its side."""

SPECK_M2 = 0.05
"""A smaller piece of floor by itself is none: no view shows so little."""


@dataclass(frozen=True)
class Rays:
    """Samples of the floor view along rays from the camera's foot, from near to far.

    Attributes:
      base: where each lies on the floor in base, m.
      pixel: (row, column) of the view.
      seen: whether the view shows it.
      foot: first sample of the ray that is not before the foot of what rises above the floor at this sample.
    """

    base: Float[np.ndarray, "A R 2"]
    pixel: Int[np.ndarray, "A R 2"]
    seen: Bool[np.ndarray, "A R"]
    foot: Int[np.ndarray, "A R"]


def occupancy(
    floors: Iterable[Bool[np.ndarray, "h w"]] | None,
    seen: Bool[np.ndarray, "h w"],
    floor_from_view: Float[np.ndarray, "3 3"],
    base_from_camera: Float[np.ndarray, "4 4"],
    world_from_base: Float[np.ndarray, "N 3"],
    floor: FloorMap,
) -> Int8[np.ndarray, "H W"]:
    """The cells of a map: 100 where something was seen to stand at least as often as not, 0 where else floor was seen.

    Args:
      floors: of each view, pixels that show floor and not what stands on it; None without depth: nothing is known to
        stand anywhere, and all that a view shows counts as floor.
      seen: pixels of a view that the camera sees.
      floor_from_view: view pixel (u, v, 1) -> (x, y, 1) in base, m.
      base_from_camera: where the camera sits.
      world_from_base: x, y (m) and heading (rad) of every view.
      floor: the floor map, whose pixels are the cells.

    Raises:
      ValueError: not as many masks as poses.
    """
    rays = rays_of(seen, floor_from_view, base_from_camera, floor.metres_per_px / SAMPLES_A_CELL)
    nothing = np.zeros_like(rays.seen)
    height, width = floor.image.shape[:2]
    votes = np.zeros((2, height * width), np.int32)
    every = itertools.repeat(None, len(world_from_base)) if floors is None else floors
    for mask, (x, y, heading) in zip(every, world_from_base, strict=True):
        clear, feet = (rays.seen, nothing) if mask is None else read(rays, mask)
        c, s = math.cos(heading), math.sin(heading)
        world = rays.base @ np.array([[c, s], [-s, c]]) + (x, y)
        column = np.floor((world[..., 0] - floor.extent[0]) / floor.metres_per_px).astype(int)
        row = np.floor((floor.extent[3] - world[..., 1]) / floor.metres_per_px).astype(int)
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        cell = row * width + column
        for kind, which in enumerate((clear, feet)):
            votes[kind, np.unique(cell[which & inside])] += 1
    clear_votes, standing_votes = votes.reshape(2, height, width)
    cells = np.where(clear_votes > standing_votes, FREE, OCCUPIED)
    return np.where(clear_votes + standing_votes > 0, cells, UNKNOWN).astype(np.int8)


def floor_only(floor: FloorMap, cells: Int8[np.ndarray, "H W"]) -> FloorMap:
    """The picture of a floor map cut down to its free cells, without the walls that views show beyond, and specks."""
    _, pieces, of_piece, _ = cv2.connectedComponentsWithStats((cells == FREE).astype(np.uint8))
    large = of_piece[:, cv2.CC_STAT_AREA] * floor.metres_per_px**2 >= SPECK_M2
    free = (cells == FREE) & large[pieces]
    if not free.any():
        return floor
    (top, bottom), (left, right) = (np.flatnonzero(free.any(axis))[[0, -1]] for axis in (1, 0))
    image = np.where(free[..., None], floor.image, 0)[top : bottom + 1, left : right + 1]
    x_min, y_max, scale = floor.extent[0], floor.extent[3], floor.metres_per_px
    x, y = x_min + scale * np.array([left, right + 1]), y_max - scale * np.array([bottom + 1, top])
    return FloorMap(image, (float(x[0]), float(x[1]), float(y[0]), float(y[1])), scale)


def rays_of(
    seen: Bool[np.ndarray, "h w"],
    floor_from_view: Float[np.ndarray, "3 3"],
    base_from_camera: Float[np.ndarray, "4 4"],
    step_m: float,
) -> Rays:
    """Rays no farther apart than their samples, as far as the view reaches."""
    v, u = np.nonzero(seen)
    shown = np.stack([u, v, np.ones_like(u)], 1) @ floor_from_view.T
    foot, height_m = base_from_camera[:2, 3], base_from_camera[2, 3]
    reach = np.linalg.norm(shown[:, :2] / shown[:, 2:] - foot, axis=1).max()
    radius = np.arange(0, reach + 2 * step_m, step_m)  # the last lies beyond the view
    angle = np.linspace(-math.pi, math.pi, math.ceil(2 * math.pi * reach / step_m), endpoint=False)
    base = foot + radius[None, :, None] * np.stack([np.cos(angle), np.sin(angle)], 1)[:, None]
    pixel = np.concatenate([base, np.ones_like(base[..., :1])], -1) @ np.linalg.inv(floor_from_view).T
    column, row = np.moveaxis(np.rint(pixel[..., :2] / pixel[..., 2:]).astype(int), -1, 0)
    inside = (row >= 0) & (row < seen.shape[0]) & (column >= 0) & (column < seen.shape[1])
    row, column = np.where(inside, row, 0), np.where(inside, column, 0)
    inside &= seen[row, column]

    # Up and depth of the point at the share s of the ray: height (1 - s), and s times the depth of its end.
    end = np.concatenate([base, np.zeros_like(base[..., :1])], -1) - base_from_camera[:3, 3]
    depth = np.maximum(end @ base_from_camera[:3, 2], 0.0)
    share = np.clip((height_m - OBSTACLE_M[0]) / (height_m + OBSTACLE_M[1] * depth), 0.0, 1.0)
    first = np.ceil(share * np.arange(len(radius))).astype(int)
    used = inside.any(1)
    return Rays(base[used], np.stack([row, column], -1)[used], inside[used], first[used])


def read(rays: Rays, floor: Bool[np.ndarray, "h w"]) -> tuple[Bool[np.ndarray, "A R"], Bool[np.ndarray, "A R"]]:
    """Samples where floor is seen, and samples where what stands on it has its foot.

    A foot is known where floor is seen from there to what hides the rest, but not along the side of what is hidden.
    """
    shown = rays.seen & floor[rays.pixel[..., 0], rays.pixel[..., 1]]
    hidden = rays.seen & ~shown
    beside = np.zeros_like(hidden)
    beside[:, GRAZING:] = (np.roll(hidden, 1, axis=0) | np.roll(hidden, -1, axis=0))[:, :-GRAZING]
    sample, last = np.arange(shown.shape[1]), shown.shape[1]
    ray, begin = np.nonzero(hidden & ~beside)
    foot = rays.foot[ray, begin]
    begins = _next(np.where(shown, last, sample))[ray, foot] == begin
    feet = np.zeros_like(shown)
    feet[ray[begins], foot[begins]] = True
    # What is next not seen as floor, hidden or out of the view, may have its foot before: no floor from there on.
    return shown & (sample < _next(np.where(shown, last, rays.foot))), feet


def _next(values: Int[np.ndarray, "A R"]) -> Int[np.ndarray, "A R"]:
    """The least value of each ray from each sample outwards."""
    return np.minimum.accumulate(values[:, ::-1], axis=1)[:, ::-1]
