"""Upright rootSIFT on Shi-Tomasi corners: the default local feature of aligned floor views, one jitted program.

A reference seen from the opposite side is not extracted again: its descriptors are turned by pi exactly.
"""

from jaxtyping import Array, Bool, Float

from ebjax.features.corners import find_corners
from ebjax.features.extractor import Extractor
from ebjax.features.matching import Features
from ebjax.models.rootsift import describe, pool_orientations, rotate_pi_descriptor

BIN_PX = 8.0
MIN_SUPPORT = 0.5
CORNERS = 400


def extract(grey: Float[Array, "H W"], seen: Bool[Array, "H W"]) -> Features:
    """Describes the strongest corners of a floor view.

    Args:
      grey: in [0, 1].
      seen: the field of view; corners whose support lies mostly outside it are not valid.
    """
    keypoints, _, valid = find_corners(grey, seen, count=CORNERS)
    descriptors, support = describe(pool_orientations(grey, seen.astype(grey.dtype), BIN_PX), keypoints)
    return Features(keypoints, descriptors, valid & (support > MIN_SUPPORT))


def turn(descriptors: Float[Array, "*n D"]) -> Float[Array, "*n D"]:
    """The descriptors of the same corners in the view turned by pi."""
    return rotate_pi_descriptor(descriptors)


ROOTSIFT = Extractor(extract, turn, jitted=True)
