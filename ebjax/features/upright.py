"""Upright rootSIFT on Shi-Tomasi corners: the default local feature of aligned floor views, one jitted program.

A reference seen from the opposite side is not extracted again: its descriptors are turned by pi exactly. The fine
bins suit a view of about 200 px; a larger one is also described at half its size, and so on: how much floor makes a
texture distinctive does not depend on how finely it is sampled.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Shaped

from ebjax.features.corners import find_corners
from ebjax.features.extractor import Extractor
from ebjax.features.matching import Features
from ebjax.models.luma import luma
from ebjax.models.rootsift import describe, pool_orientations, rotate_pi_descriptor

BIN_PX = 6.0
MIN_SUPPORT = 0.5
CORNERS = 600
RADIUS_PX = 2
OCTAVE_PX = 200


def octaves(height: int, width: int) -> int:
    """How often a view is described, each time at half the size: once below 400 px, twice below 800 px, and so on."""
    return 1 + max(0, math.floor(math.log2(min(height, width) / OCTAVE_PX)))


def extract(view: Float[Array, "H W 3"], seen: Bool[Array, "H W"]) -> Features:
    """Describes the strongest corners of a floor view, 600 an octave.

    Args:
      view: RGB in [0, 1]; its luma is described.
      seen: the field of view; corners whose support lies mostly outside it are not valid.
    """
    grey, found = luma(view), []
    for octave in range(octaves(*grey.shape)):
        keypoints, _, valid = find_corners(grey, seen, count=CORNERS, radius=RADIUS_PX)
        descriptors, support = describe(pool_orientations(grey, seen.astype(grey.dtype), BIN_PX), keypoints)
        scale = 2**octave
        found.append(Features((keypoints + 0.5) * scale - 0.5, descriptors, valid & (support > MIN_SUPPORT)))
        grey, seen = halved(grey).mean((1, 3)), halved(seen).all((1, 3))
    return jax.tree.map(lambda *rows: jnp.concatenate(rows), *found)


def halved(image: Shaped[Array, "H W *c"]) -> Shaped[Array, "h 2 w 2 *c"]:
    """The 2 x 2 blocks of an image; an odd last row or column is left out."""
    height, width = image.shape[0] // 2, image.shape[1] // 2
    return image[: 2 * height, : 2 * width].reshape(height, 2, width, 2, *image.shape[2:])


def turn(descriptors: Float[Array, "*n D"]) -> Float[Array, "*n D"]:
    """The descriptors of the same corners in the view turned by pi."""
    return rotate_pi_descriptor(descriptors)


ROOTSIFT = Extractor(extract, jitted=True, turn=turn, octaves=octaves)
