"""From score maps to keypoints, in fixed shapes: non-maximum suppression, the strongest places, what is read there.

Every function takes one map; `jax.vmap` it over a batch.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ebjax.geometry.pytree import pytree
from ebjax.geometry.warp import sample_bilinear
from ebjax.models.layers import normalise


@pytree
class Detections:
    """Keypoints of one image, strongest first; rows that are not `valid` come last and hold anything."""

    keypoints: Float[Array, "*n K 2"]  # (x, y) px, the centre of the top-left pixel at (0, 0)
    scores: Float[Array, "*n K"]
    descriptors: Float[Array, "*n K D"]  # unit length
    scale: Float[Array, "*n K"]  # image px for each px of the scale the keypoint was found at
    valid: Bool[Array, "*n K"]


def window_max(values: Float[Array, "H W"], radius: int) -> Float[Array, "H W"]:
    """The maximum of the square window of 2 radius + 1 px around every pixel; outside the map is -inf."""
    low = jnp.asarray(-jnp.inf, values.dtype)
    for window in ((2 * radius + 1, 1), (1, 2 * radius + 1)):
        values = jax.lax.reduce_window(values, low, jax.lax.max, window, (1, 1), "SAME")
    return values


def _near(mask: Bool[Array, "H W"], radius: int) -> Bool[Array, "H W"]:
    return window_max(mask.astype(jnp.float32), radius) > 0


def suppress_twice(scores: Float[Array, "H W"], radius: int) -> Bool[Array, "H W"]:
    """Local maxima, and twice those of what they leave over (SuperGlue, hloc, ALIKE); equal neighbours all stay."""
    scores = jax.lax.stop_gradient(scores)
    found = scores == window_max(scores, radius)
    for _ in range(2):
        free = ~_near(found, radius)
        rest = jnp.where(free, scores, -jnp.inf)
        found |= free & (rest == window_max(rest, radius))
    return found


def suppress_greedily(scores: Float[Array, "H W"], candidates: Bool[Array, "H W"], radius: int) -> Bool[Array, "H W"]:
    """Greedy suppression: the best candidate stays, those within the square around it go, and so on (Magic Leap).

    All candidates that are best in their own window are taken at once, which gives the same set; of equal ones the
    first in raster order counts as the better.
    """
    order = jnp.argsort(-jax.lax.stop_gradient(scores).reshape(-1), stable=True)
    # float32 holds every rank of a map below 16 million pixels.
    rank = jnp.zeros(scores.size, jnp.float32).at[order].set(-jnp.arange(scores.size, dtype=jnp.float32))
    rank = rank.reshape(scores.shape)

    def step(state: tuple[Array, Array]) -> tuple[Array, Array]:
        found, free = state
        rest = jnp.where(free, rank, -jnp.inf)
        best = free & (rest == window_max(rest, radius))
        return found | best, free & ~_near(best, radius)

    found, _ = jax.lax.while_loop(lambda state: state[1].any(), step, (jnp.zeros_like(candidates), candidates))
    return found


def inside(size: Sequence[int], border: int, far_border: Sequence[int]) -> Bool[Array, "H W"]:
    """Marks the pixels at least `border` px from the top and left edges and (y, x) `far_border` px from the others."""
    rows, columns = (jnp.arange(length) for length in size)
    good_rows = (rows >= border) & (rows < size[0] - far_border[0])
    good_columns = (columns >= border) & (columns < size[1] - far_border[1])
    return good_rows[:, None] & good_columns[None, :]


def strongest(
    scores: Float[Array, "H W"], found: Bool[Array, "H W"], count: int
) -> tuple[Int[Array, "K 2"], Bool[Array, " K"]]:
    """(x, y) of the `count` marked pixels of highest score, best first, and which rows are such pixels.

    `count` above H W gives H W rows: every marked pixel.
    """
    values = jnp.where(found, scores, -jnp.inf).reshape(-1)
    best, index = jax.lax.top_k(jax.lax.stop_gradient(values), min(count, values.size))
    return jnp.stack([index % scores.shape[1], index // scores.shape[1]], -1), best > -jnp.inf


def soft_argmax(
    scores: Float[Array, "H W"], pixels: Int[Array, "K 2"], radius: int, temperature: float
) -> Float[Array, "K 2"]:
    """The mean of a window under softmax(score / temperature): sub-pixel places (x, y), differentiable in the scores.

    Args:
      scores: the map.
      pixels: (x, y) of the windows' centres.
      radius: of the window, px; outside the map counts as score 0.
      temperature: of the softmax.
    """
    padded = jnp.pad(scores, radius)
    steps = jnp.arange(-radius, radius + 1)
    rows = pixels[:, 1, None, None] + radius + steps[None, :, None]
    columns = pixels[:, 0, None, None] + radius + steps[None, None, :]
    patches = padded[rows, columns].reshape(len(pixels), -1)
    dy, dx = jnp.meshgrid(steps, steps, indexing="ij")
    offsets = jnp.stack([dx.reshape(-1), dy.reshape(-1)], -1).astype(scores.dtype)
    weights = jax.nn.softmax(patches / temperature, axis=1)
    return pixels.astype(scores.dtype) + jnp.matmul(weights, offsets, precision="highest")


def read_descriptors(descriptor_map: Float[Array, "h w D"], points: Float[Array, "K 2"]) -> Float[Array, "K D"]:
    """Bilinear reads at (x, y) in cells of the map, zero outside it, made unit."""
    return normalise(sample_bilinear(descriptor_map, points))
