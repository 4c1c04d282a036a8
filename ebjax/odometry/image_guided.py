"""Matches that a motion predicts: partners looked for where it puts them, without asking that they be unique.

Where two images have little in common the ratio test leaves a dozen matches. A right motion finds several times as
many this way and a wrong one hardly more than chance, so that they also decide between motions. Only corners of known
depth and of the floor take part: an epipolar line is long enough for chance. Host side, NumPy.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from ebjax.odometry.image_matches import ImageFeatures
from ebjax.odometry.planar_motion import Pairs
from ebjax.odometry.planar_motion_cost import segments

MOST = 400
"""The strongest corners of each image that take part."""
NEAR_PX = 4.0
DISTANCE = 0.45
"""Largest RootSIFT distance: right partners lie within 0.2 to 0.45, one other corner in fifty does."""


def _reachable(
    motion: Float[np.ndarray, "3"], pixels_i: Float[np.ndarray, "K 2"], corners_j: Pairs, px: float
) -> Bool[np.ndarray, "N K"]:
    """Whether the motion brings corner n of image j, on the floor or of known depth, near corner k of image i."""
    far_x, far_y, dx, dy, bend, ratio = (a.astype(np.float32)[:, None] for a in segments(motion, corners_j))
    known = np.where(corners_j.has_depth | corners_j.may_be_floor, corners_j.known, np.nan).astype(np.float32)[:, None]
    x, y = pixels_i.astype(np.float32).T
    ox, oy = x - far_x, y - far_y
    at = known / np.maximum(1 + bend * known, np.float32(0.05))
    return ((ox - dx * at) ** 2 + (oy - dy * at) ** 2 < (NEAR_PX * px) ** 2) & (ratio > 0.05)


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
    good = np.flatnonzero((best >= cosine.max(0)[partner]) & (best > 1 - DISTANCE**2 / 2))
    good = good[np.argsort(-best[good], kind="stable")]
    places = np.round(np.hstack([two.keypoints[good], one.keypoints[partner[good]]]))
    good = good[np.sort(np.unique(places, axis=0, return_index=True)[1])]
    return partner[good], good
