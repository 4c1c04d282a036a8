"""Corners of the whole image and their partners in another one: SIFT by OpenCV, RootSIFT distances.

Host side, NumPy. Pixels are (x, y), the centre of the top-left pixel at (0, 0).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

COUNT = 1500
CONTRAST = 0.01
"""Floors are faint: OpenCV's 0.04 leaves a dozen keypoints on polished stone."""
LONGEST_SIDE = 1000
"""Larger images are halved until they fit: corners are found to a share of a pixel, and time grows with the area."""
QUICK_SIDE = 500
"""... where wheels say most of the motion: a fourth of the pixels, and corners less exact."""
CELLS = 12
"""Cells along the longer side of the image; each gives its strongest corner before any gives its second."""
BORDER_PX = 6
RATIO = 0.8


@dataclass(frozen=True)
class ImageFeatures:
    """Corners of one image.

    Attributes:
      keypoints: where they are, px: raw ones of `image_features`, ideal ones where motions are measured.
      descriptors: RootSIFT, unit length.
      sizes_px: the diameters of the patches they describe; larger ones lie less exactly.
      unit_px: pixels of the raw image in one of those that were searched: 1, or 2, 4, ... where it was halved.
      stretch: ideal pixels in a raw one, at each corner; None: 1.
      depth_m: along the optical axis at each corner, 0 where missing; None: the image has no depth.
    """

    keypoints: Float[np.ndarray, "N 2"]
    descriptors: Float[np.ndarray, "N 128"]
    sizes_px: Float[np.ndarray, " N"]
    unit_px: float = 1.0
    stretch: Float[np.ndarray, " N"] | None = None
    depth_m: Float[np.ndarray, " N"] | None = None

    def __len__(self) -> int:
        """Returns the number of corners."""
        return len(self.keypoints)


def spread_rows(
    points: Float[np.ndarray, "N 2"], responses: Float[np.ndarray, " N"], cell_px: float, count: int
) -> Int[np.ndarray, " K"]:
    """Rows of `count` points: the strongest of every cell first, then the second of every cell, and so on."""
    columns, rows = np.floor(points / cell_px).astype(np.int64).T
    cell = rows * 4096 + columns
    order = np.lexsort((-responses, cell))
    first = np.concatenate([[True], np.diff(cell[order]) != 0])[: len(order)]
    place = np.arange(len(order))
    rank = place - np.maximum.accumulate(np.where(first, place, 0))
    return order[np.lexsort((-responses[order], rank))][:count]


def image_features(
    rgb: UInt8[np.ndarray, "H W 3"],
    mask: Bool[np.ndarray, "h w"] | None = None,
    *,
    count: int = COUNT,
    longest_side: int = LONGEST_SIDE,
) -> ImageFeatures:
    """Finds SIFT corners, spread over the image, and describes them by RootSIFT (Arandjelovic and Zisserman 2012).

    Args:
      rgb: the raw image.
      mask: where corners may lie; give it where the robot sees its own body. None: everywhere.
      count: how many at most.
      longest_side: of the image that is searched, px.

    Raises:
      ValueError: the mask has another size than the image.
    """
    if mask is not None and mask.shape != rgb.shape[:2]:
        raise ValueError(f"mask is {mask.shape}, the image {rgb.shape[:2]}; give one value a pixel")
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    halvings = max(0, int(np.ceil(np.log2(max(grey.shape) / longest_side))))
    for _ in range(halvings):
        grey = cv2.resize(grey, (grey.shape[1] // 2, grey.shape[0] // 2), interpolation=cv2.INTER_AREA)
    allowed = None
    if mask is not None:
        allowed = cv2.resize(mask.astype(np.uint8), grey.shape[::-1], interpolation=cv2.INTER_NEAREST)
    # Without precise upscaling the doubled first octave lies a quarter of a pixel off.
    detector = cv2.SIFT.create(2 * count, 3, CONTRAST, 10, 1.6, True)
    keypoints, descriptors = detector.detectAndCompute(grey, allowed)
    if descriptors is None:
        return ImageFeatures(np.zeros((0, 2)), np.zeros((0, 128), np.float32), np.zeros(0))
    points = np.array([k.pt for k in keypoints])
    limit = np.array(grey.shape[::-1]) - 1 - BORDER_PX
    inside = np.flatnonzero(((points >= BORDER_PX) & (points <= limit)).all(1))
    responses = np.array([k.response for k in keypoints])
    keep = inside[spread_rows(points[inside], responses[inside], max(grey.shape) / CELLS, count)]
    root = np.sqrt(descriptors[keep] / np.maximum(descriptors[keep].sum(1, keepdims=True), 1e-6))
    factor = 2.0**halvings
    sizes = np.array([k.size for k in keypoints])[keep] * factor
    return ImageFeatures((points[keep] + 0.5) * factor - 0.5, root.astype(np.float32), sizes, factor)


def match_features(
    one: ImageFeatures, two: ImageFeatures, ratio: float = RATIO
) -> tuple[Int[np.ndarray, " M"], Int[np.ndarray, " M"]]:
    """Rows of both that are each other's nearest, and nearer than `ratio` times the second nearest; best first."""
    if min(len(one), len(two)) < 2:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    cosine = one.descriptors @ two.descriptors.T
    rows = np.arange(len(one))
    partner, column_best = cosine.argmax(1), cosine.max(0)
    best = cosine[rows, partner]
    cosine[rows, partner] = -1
    second = cosine.max(1)
    share = np.sqrt(np.maximum(1 - best, 0) / np.maximum(1 - second, 1e-9))
    good = np.flatnonzero((best >= column_best[partner]) & (share < ratio))
    good = good[np.argsort(share[good], kind="stable")]
    # A corner with two orientations is one corner.
    places = np.round(np.hstack([one.keypoints[good], two.keypoints[partner[good]]]))
    good = good[np.sort(np.unique(places, axis=0, return_index=True)[1])]
    return good, partner[good]
