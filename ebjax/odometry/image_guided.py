"""Matches that a motion predicts: partners looked for where it puts them, without asking that they be unique.

Where two images have little in common the ratio test leaves a dozen matches. A right motion finds several times as
many this way and a wrong one hardly more than chance, so that they also decide between motions. Host side, NumPy.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from ebjax.odometry.image_matches import ImageFeatures
from ebjax.odometry.planar_motion import Pairs
from ebjax.odometry.planar_motion_cost import RHO_MAX, segments

MOST = 500
"""The strongest corners of each image that take part."""
EXACT_PX = 5.0
LINE_PX = 2.0
DISTANCE = 0.45
"""Largest RootSIFT distance: right partners lie within 0.2 to 0.45, one other corner in fifty does."""


def _reachable(
    motion: Float[np.ndarray, "3"], pixels_i: Float[np.ndarray, "K 2"], corners_j: Pairs, px: float
) -> Bool[np.ndarray, "N K"]:
    """Whether the motion may bring corner n of image j to corner k of image i."""
    far_x, far_y, dx, dy, bend, ratio = (a.astype(np.float32)[:, None] for a in segments(motion, corners_j))
    known = np.where(np.isnan(corners_j.rho_j), corners_j.rho_floor, corners_j.rho_j).astype(np.float32)[:, None]
    x, y = pixels_i.astype(np.float32).T
    ox, oy = x - far_x, y - far_y
    at = known / np.maximum(1 + bend * known, np.float32(0.05))
    exact = (ox - dx * at) ** 2 + (oy - dy * at) ** 2 < (EXACT_PX * px) ** 2
    length = np.sqrt(dx * dx + dy * dy) + np.float32(1e-9)
    reach = length * np.float32(RHO_MAX) / np.maximum(1 + bend * np.float32(RHO_MAX), np.float32(0.05))
    along, across = (ox * dx + oy * dy) / length, (ox * dy - oy * dx) / length
    margin = np.float32(LINE_PX * px)
    line = (np.abs(across) < margin) & (along > -margin) & (along < reach + margin)
    measured = ~np.isnan(corners_j.rho_j)[:, None]
    return (exact | (line & ~measured)) & (ratio > 0.05)


def guided_matches(
    motion: Float[np.ndarray, "3"], one: ImageFeatures, two: ImageFeatures, corners_two: Pairs
) -> tuple[Int[np.ndarray, " M"], Int[np.ndarray, " M"]]:
    """Rows of both images that the motion allows and that are each other's nearest among the allowed; nearest first.

    Args:
      motion: (bx, by, theta) of the camera.
      one: image i.
      two: image j.
      corners_two: the corners of image j, in their order, by `make_pairs` with anything for image i.
    """
    one_count, two_count = min(len(one), MOST), min(len(two), MOST)
    allowed = _reachable(motion, one.keypoints[:one_count], corners_two.take(np.arange(two_count)), one.unit_px)
    cosine = np.where(allowed, two.descriptors[:two_count] @ one.descriptors[:one_count].T, np.float32(-1))
    if not cosine.size:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    rows, partner = np.arange(two_count), cosine.argmax(1)
    best = cosine[rows, partner]
    good = np.flatnonzero((cosine.argmax(0)[partner] == rows) & (best > 1 - DISTANCE**2 / 2))
    good = good[np.argsort(-best[good], kind="stable")]
    places = np.round(np.hstack([two.keypoints[good], one.keypoints[partner[good]]]))
    good = good[np.sort(np.unique(places, axis=0, return_index=True)[1])]
    return partner[good], good
