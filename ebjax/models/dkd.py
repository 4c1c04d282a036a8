"""The differentiable keypoint search of ALIKE and ALIKED: local maxima of a score map, to a fraction of a pixel."""

from functools import partial

import jax
from jaxtyping import Array, Bool, Float

from ebjax.geometry.warp import sample_bilinear
from ebjax.models.detect import inside, soft_argmax, strongest, suppress_twice

RADIUS = 2
TEMPERATURE = 0.1


@partial(jax.jit, static_argnames=("count", "border", "sub_pixel"))
def find_keypoints(
    scores: Float[Array, "H W"],
    *,
    count: int,
    threshold: float | Float[Array, ""],
    border: int = RADIUS,
    sub_pixel: bool = True,
) -> tuple[Float[Array, "K 2"], Float[Array, " K"], Bool[Array, " K"]]:
    """Places (x, y) px of the strongest scores, best first, the scores read there, and which rows are such places.

    Args:
      scores: the map.
      count: of rows; above H W every one.
      threshold: lowest score, before the sub-pixel step.
      border: rows and columns at the top and left without keypoints; at the other sides there are RADIUS.
      sub_pixel: move keypoints to the mean of their 5x5 window under softmax(score / 0.1): differentiable.
    """
    found = suppress_twice(scores, RADIUS) & inside(scores.shape, border, (RADIUS, RADIUS)) & (scores > threshold)
    pixels, valid = strongest(scores, found, count)
    keypoints = soft_argmax(scores, pixels, RADIUS, TEMPERATURE) if sub_pixel else pixels.astype(scores.dtype)
    return keypoints, sample_bilinear(scores[..., None], keypoints)[:, 0], valid
