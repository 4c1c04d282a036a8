"""How far a D2-Net keypoint lies from itself when it is read through R_pi: a matter of geometry, not of weights.

Every kernel gives way to the mean of itself and its own turn by pi. Such a network sees the same in a turned image, so
the turned keypoints must come back to where they were; a half-cell bias makes them miss by twice its length.
"""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from flax import nnx
from jaxtyping import Array, Float, UInt8

from ebjax.models.catalogue import restore
from ebjax.models.d2net import D2Net, Offset, convert, detect
from ebjax.models.seeded import seeded_state
from ebjax.models.weights import flat_arrays, load_into

EVERY = 10**7


def symmetric(network: nnx.Module) -> D2Net:
    """The network with kernels that are their own turn by pi, of about the same gain."""
    arrays = {key: np.asarray(array) for key, array in flat_arrays(network).items()}
    turned = {key: (a + a[::-1, ::-1]) / np.sqrt(2) if a.ndim == 4 else a for key, a in arrays.items()}
    result: Any = nnx.merge(*nnx.split(network))
    load_into(result, turned)
    return result


def stand_in(seed: int) -> D2Net:
    """A symmetric network with weights from a seed."""
    return symmetric(restore("d2net", convert(seeded_state("d2net", seed))))


def middle(image: UInt8[np.ndarray, "H W 3"], most: int = 480) -> UInt8[np.ndarray, "h w 3"]:
    """The middle of an image, with sides that are multiples of 4 and at most `most` px."""
    height, width = (min(length, most) // 4 * 4 for length in image.shape[:2])
    top, left = (image.shape[0] - height) // 2, (image.shape[1] - width) // 2
    return image[top : top + height, left : left + width]


def through_turn(
    network: D2Net, image: Float[Array, "H W 3"], offset: Offset, scales: Sequence[float] = (1.0,)
) -> tuple[Float[np.ndarray, "K 2"], Float[np.ndarray, "K 2"]]:
    """Keypoints of an image and, for each, the same keypoint of the turned image brought back.

    Args:
      network: from `symmetric`.
      image: RGB in [0, 1], sides multiples of 4 at every scale.
      offset: as in `detect`.
      scales: as in `detect`.

    Raises:
      ValueError: the two do not have the same keypoints.
    """
    found = []
    for view in (image, image[::-1, ::-1]):
        rows = jax.tree.map(np.asarray, detect(network, view, count=EVERY, scales=scales, offset=offset))
        rows = jax.tree.map(lambda leaf, valid=rows.valid: leaf[valid], rows)
        # Scores tell keypoints apart: one keypoint has the same in both.
        order = np.lexsort((rows.scores, rows.scale))
        found.append((rows.keypoints[order], rows.scores[order], rows.scale[order]))
    (straight, scores, scale), (turned, other_scores, other_scale) = found
    same = len(scores) == len(other_scores) and (scale == other_scale).all()
    if not same or not np.allclose(scores, other_scores, rtol=1e-3):
        raise ValueError(
            f"{len(scores)} keypoints, {len(other_scores)} others in the turned image; "
            "give an image with sides that are multiples of 4 at every scale"
        )
    last = np.array([image.shape[1] - 1, image.shape[0] - 1], straight.dtype)
    return straight, last - turned
