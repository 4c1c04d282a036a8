"""Pixels that are fixed to the image while the robot moves: its own body, dirt on the lens, a frame, a caption.

The mean over frames of a gradient g keeps what stays in the image and loses what moves. With M = E[g] E[g]^T and
T = E[g g^T], both smoothed, the share of structure that stays is M against T. Its smaller generalised eigenvalue asks
for structure in two directions: a grout line along the drive stays in the image too, yet it is floor.
Grey levels are 0 to 255; all lengths below are in pixels of the reduced images, at most 320 px wide.
"""

from collections.abc import Iterable
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Integer, UInt8

WIDTH_PX = 320
MEAN_GREY, MOST_GAIN = 110.0, 4.0
FEWEST_FRAMES = 8
CHANGE, CHANGED_SHARE = 3.0, 0.2
"""Frames differ where this share of their pixels changes by more than this, grey levels."""
SOFT_GRADIENT = 4.0
"""Gradients far above this (grey levels/px) count by direction alone: exposure and contrast fall out."""
NOISE = 0.02
WINDOW_PX, FINE_PX = 2.5, 1.0
STILL, MOVING, CORNERS = 0.35, 0.15, 0.25
"""Shares of structure that stays: of an outline at least, of moving floor at most, and in every direction at least."""
ENCLOSED, BESIDE_BLACK, CORNERED = 0.9, 0.5, 0.1
"""Shares of the rim of a smooth part: still outlines at least, the same where it is black, and corners at least."""
BLACK = 12.0
SPECK_PX2, GAP_PX, MARGIN_PX = 25, 16, 1
MOST_MASKED = 0.7


class Stillness(NamedTuple):
    """Structure at every pixel (0 to 1), the share of it that stays, and that share in the direction of the least."""

    structure: Float32[np.ndarray, "h w"]
    share: Float32[np.ndarray, "h w"]
    least: Float32[np.ndarray, "h w"]


def spread(travelled: Integer[np.ndarray, " N"] | Float[np.ndarray, " N"], most: int = 32) -> Int[np.ndarray, " n"]:
    """Indices of images for `static_pixels`: spread over the way, none where the robot stands.

    The steps are uneven: frames a whole number of tiles apart would make the tiles look fixed to the image.

    Args:
      travelled: how far the robot has come at every image, not decreasing (turns may count); `np.arange` if unknown.
      most: how many at most.
    """
    edges = np.linspace(travelled[0], travelled[-1], most + 1)
    ways = edges[:-1] + np.random.default_rng(0).uniform(size=most) * np.diff(edges)
    return np.unique(np.minimum(np.searchsorted(travelled, ways), len(travelled) - 1))


def static_pixels(images: Iterable[UInt8[np.ndarray, "_ _ 3"]]) -> Bool[np.ndarray, "H W"]:
    """True where the picture is fixed to the image; nothing where fewer than 8 frames differ from each other.

    A textured part is found whole, the inside of a smooth one only where its rim has corners or where it is black;
    of other smooth parts the outline is found. Where more than 70 % stays, the robot did not move: nothing is found.

    Args:
      images: RGB frames of one camera, spread over the run while the robot moved (`spread`); 32 are plenty.

    Raises:
      ValueError: no image, or images of several sizes.
    """
    sizes, frames = set(), []
    for image in images:
        sizes.add(image.shape[:2])
        frames.append(_reduced(image))
    if len(sizes) != 1:
        raise ValueError(f"static_pixels needs images of one size, got {sorted(sizes) or 'none'}; give one camera's")
    height, width = sizes.pop()
    frames = _distinct(frames)
    if len(frames) < FEWEST_FRAMES:
        return np.zeros((height, width), bool)
    mask = _regions(*_stillness(frames), brightest=np.max(frames, axis=0))
    if mask.mean() > MOST_MASKED:
        return np.zeros((height, width), bool)
    return cv2.resize(mask.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0


def _reduced(image: UInt8[np.ndarray, "H W 3"]) -> Float32[np.ndarray, "h w"]:
    """Grey, small, and of one mean brightness."""
    height, width = image.shape[:2]
    factor = min(1.0, WIDTH_PX / max(height, width))
    size = max(1, round(width * factor)), max(1, round(height * factor))
    grey = cv2.cvtColor(cv2.resize(image, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY)
    return grey * np.float32(min(MOST_GAIN, MEAN_GREY / max(grey.mean(), 1.0)))


def _distinct(frames: list[Float32[np.ndarray, "h w"]]) -> list[Float32[np.ndarray, "h w"]]:
    """Without frames that show what an earlier one shows: those of a robot that stands count once."""
    kept: list[tuple[np.ndarray, np.ndarray]] = []
    for frame in frames:
        few = cv2.resize(frame, (0, 0), fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)[::3, ::3]
        if all(_changed_share(few, other) > CHANGED_SHARE for _, other in kept):
            kept.append((frame, few))
    return [frame for frame, _ in kept]


def _changed_share(a: Float32[np.ndarray, "h w"], b: Float32[np.ndarray, "h w"]) -> float:
    """Of pixels, beyond the change of exposure that fits most of them."""
    return float(np.mean(np.abs(a - b * np.median(a / np.maximum(b, 1))) > CHANGE))


def _stillness(frames: list[Float32[np.ndarray, "h w"]]) -> tuple[Stillness, Stillness]:
    """In a window that joins what belongs together, and in a finer one that sees outlines more exactly."""
    means, products = np.zeros((2, *frames[0].shape), np.float32), np.zeros((3, *frames[0].shape), np.float32)
    for frame in frames:
        x = cv2.Scharr(frame, cv2.CV_32F, 1, 0, scale=1 / 32)
        y = cv2.Scharr(frame, cv2.CV_32F, 0, 1, scale=1 / 32)
        scale = 1 / np.sqrt(x * x + y * y + SOFT_GRADIENT**2)
        x, y = x * scale, y * scale
        for total, value in zip((*means, *products), (x, y, x * x, x * y, y * y), strict=True):
            total += value
    # The border lacks its gradient across: a line that meets it would look like a corner.
    for total in (means, products):
        total[:, [0, -1]] = total[:, :, [0, -1]] = 0
    (x, y), products = means / len(frames), products / len(frames)
    stays = np.stack([x * x, x * y, y * y])
    # E[mean mean^T] = stays + (all - stays) / n for n independent frames: take the second part away.
    stays = (len(frames) * stays - products) / (len(frames) - 1)
    return _shares(stays, products, WINDOW_PX), _shares(stays, products, FINE_PX)


def _shares(stays: Float32[np.ndarray, "3 h w"], products: Float32[np.ndarray, "3 h w"], sigma: float) -> Stillness:
    """Trace ratio and smaller eigenvalue of `stays` relative to `products`, both as (xx, xy, yy)."""
    (a, b, c), (p, q, r) = ([cv2.GaussianBlur(part, (0, 0), sigma) for part in tensor] for tensor in (stays, products))
    structure = p + r
    p, r = p + NOISE, r + NOISE
    determinant, middle = p * r - q * q, (a * r + c * p) / 2 - b * q
    root = np.sqrt(np.maximum(middle**2 - determinant * (a * c - b * b), 0))
    return Stillness(structure, (a + c) / (p + r), (middle - root) / determinant)


def _regions(joined: Stillness, fine: Stillness, *, brightest: Float32[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Still corners, the smooth parts that still structure encloses, and the gaps between them."""
    floor = float(np.clip(2 * np.percentile(joined.structure, 1), 0.03, 0.3))
    sharp = (fine.structure > floor) & (fine.share > STILL)
    corners = _without_specks((joined.least > CORNERS) & _grown(sharp, 1))
    moving = (joined.structure > floor) & (joined.share < MOVING)
    outline = sharp | (joined.structure > floor) & (joined.share > STILL)
    smooth, rims = _enclosed(joined.structure <= floor, outline, corners, brightest < BLACK)
    mask = corners | smooth & ~moving
    # Padded by its border, so that what the border cuts is closed as if it went on.
    around = np.pad(mask.astype(np.uint8), GAP_PX + 1, mode="edge")
    inner = slice(GAP_PX + 1, -GAP_PX - 1)
    closed = cv2.morphologyEx(around, cv2.MORPH_CLOSE, _disk(GAP_PX))[inner, inner] > 0
    mask = (mask | closed & ~moving) & ~((fine.structure > floor) & (fine.share < MOVING)) | rims
    tidy = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, _disk(2))
    tidy = cv2.morphologyEx(tidy, cv2.MORPH_OPEN, _disk(1))
    return _grown(_without_specks(tidy > 0), MARGIN_PX)


def _enclosed(
    smooth: Bool[np.ndarray, "h w"],
    outline: Bool[np.ndarray, "h w"],
    corners: Bool[np.ndarray, "h w"],
    black: Bool[np.ndarray, "h w"],
) -> tuple[Bool[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Smooth parts that outlines and the image's border enclose, where these are sure; and the rims of all of them.

    Sure are black ones and those with corners on their rims: bare floor between two skirting boards has none.
    """
    opened = cv2.morphologyEx(smooth.astype(np.uint8), cv2.MORPH_OPEN, _disk(2))
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(opened, connectivity=4)
    near = cv2.dilate(labels.astype(np.float32), _disk(3)).astype(int)
    rim = np.where(labels == 0, near, 0)
    length = np.maximum(np.bincount(rim.ravel(), minlength=count), 1)
    area = boxes[:, cv2.CC_STAT_AREA]
    still = np.bincount(rim.ravel(), _grown(outline, 2).ravel(), count) / length
    cornered = np.bincount(rim.ravel(), corners.ravel(), count) / length >= CORNERED
    unlit = np.bincount(labels.ravel(), black.ravel(), count) / area > 0.95
    closed = (np.arange(count) > 0) & (area >= SPECK_PX2) & (still >= np.where(unlit, BESIDE_BLACK, ENCLOSED))
    return _grown((closed & (cornered | unlit))[labels], 5), _grown(closed[labels], 7) & outline


def _without_specks(mask: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    kept = boxes[:, cv2.CC_STAT_AREA] >= SPECK_PX2
    kept[0] = False
    return kept[labels]


def _grown(mask: Bool[np.ndarray, "h w"], radius: int) -> Bool[np.ndarray, "h w"]:
    return cv2.dilate(mask.astype(np.uint8), _disk(radius)) > 0


def _disk(radius: int) -> UInt8[np.ndarray, "n n"]:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))  # type: ignore[return-value]
