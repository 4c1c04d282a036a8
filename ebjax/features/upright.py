"""Upright rootSIFT on blobs: a local feature of aligned floor views, one jitted program.

A reference seen from the opposite side is not extracted again: its descriptors are turned by pi exactly. The fine
bins suit a view of about 200 px; a larger one is also described at half its size, and so on: how much floor makes a
texture distinctive does not depend on how finely it is sampled.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Shaped

from ebjax.features.blobs import find_blobs
from ebjax.features.extractor import Extractor
from ebjax.features.matching import Features
from ebjax.models.luma import luma
from ebjax.models.rootsift import describe, pool_orientations, rotate_pi_descriptor

BIN_PX = 6.0
MIN_SUPPORT = 0.5
BLOBS, MORE_BLOBS = 600, 900
"""Of a view, and of each octave of a larger one: what shows more floor finely says more."""
RADIUS_PX = 2
OCTAVE_PX = 200
VERSION = 2
"""Of local features at blobs; they were at corners before."""


def octaves(height: int, width: int) -> int:
    """How often a view is described, each time at half the size: once below 400 px, twice below 800 px, and so on."""
    return 1 + max(0, math.floor(math.log2(min(height, width) / OCTAVE_PX)))


def blobs_an_octave(height: int, width: int) -> int:
    """How many rows each octave of a view has."""
    return BLOBS if octaves(height, width) == 1 else MORE_BLOBS


def extract(view: Float[Array, "H W 3"], seen: Bool[Array, "H W"]) -> Features:
    """Describes the strongest blobs of a floor view, 600, or 900 an octave where there are several.

    Args:
      view: RGB in [0, 1]; its luma is described.
      seen: the field of view; blobs whose support lies mostly outside it are not valid.
    """
    grey, found = luma(view), []
    count = blobs_an_octave(*grey.shape)
    for octave in range(octaves(*grey.shape)):
        keypoints, _, valid = find_blobs(grey, seen, count=count, radius=RADIUS_PX)
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
    """The descriptors of the same keypoints in the view turned by pi."""
    return rotate_pi_descriptor(descriptors)


ROOTSIFT = Extractor(extract, jitted=True, turn=turn, octaves=octaves, version=VERSION)
