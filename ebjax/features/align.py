"""Where a corner of one floor view lies in another, to a few hundredths of a pixel: aligned patches, not two corners.

A corner is a peak of contrast, and contrast falls with the distance from the camera. So a corner is found a little
nearer than what makes it, the farther the more: steps came out short by 0.03 %, which adds up. The patch around it
has no such pull and uses more of the picture (Lucas and Kanade, 1981): errors of steps are halved.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, UInt8

from ebjax.geometry.homography import apply

RADIUS = 5
SPREAD_PX = 3.0
"""Standard deviation of the window's weights."""
ROUNDS = 3
MOST_PX = 1.5
"""A corner that moves farther than this has found something else, and stays where it was."""
LEAST_GAIN = 0.2
"""Of a patch's contrast in the one view over that in the other."""


def _bilinear(image: Float[Array, "h w"], points: Float[Array, "*n 2"]) -> Float[Array, " *n"]:
    height, width = image.shape
    corner = jnp.floor(points)
    x, y = points[..., 0] - corner[..., 0], points[..., 1] - corner[..., 1]
    column = jnp.clip(corner[..., 0].astype(jnp.int32), 0, width - 2)
    row = jnp.clip(corner[..., 1].astype(jnp.int32), 0, height - 2)
    first, flat = row * width + column, image.reshape(-1)
    a, b, c, d = (flat.at[first + k].get(mode="promise_in_bounds") for k in (0, 1, width, width + 1))
    above, below = a + x * (b - a), c + x * (d - c)
    return above + y * (below - above)


def _around(image: Float[Array, "h w"], points: Float[Array, "M 2"]) -> Float[Array, "M side side"]:
    """Square patches around points: whole ones are cut out and shifted by the fraction."""
    side = 2 * RADIUS + 1
    corner = jnp.floor(points)
    x, y = (points - corner)[:, 0, None, None], (points - corner)[:, 1, None, None]
    first = corner.astype(jnp.int32) - RADIUS

    def cut(at):
        return jax.lax.dynamic_slice(image, (at[1], at[0]), (side + 1, side + 1))

    p = jax.vmap(cut)(first)
    rows = (1 - y) * p[:, :-1] + y * p[:, 1:]
    return (1 - x) * rows[:, :, :-1] + x * rows[:, :, 1:]


def aligned(
    view_i: UInt8[Array, "h w"],
    view_j: UInt8[Array, "h w"],
    i_from_j: Float[Array, "3 3"],
    points_i: Float[Array, "M 2"],
    points_j: Float[Array, "M 2"],
) -> tuple[Float[Array, "M 2"], Bool[Array, " M"]]:
    """Points of view i moved to where the patches around their partners of view j fit best.

    Brightness and contrast of a patch may differ between the views. Points near a border are left alone.

    Args:
      view_i: grey.
      view_j: grey, of the same floor.
      i_from_j: pixels of view i from pixels of view j, right to about a pixel; turns and scales the patches.
      points_i: (x, y) px in view i.
      points_j: their partners in view j, px.

    Returns:
      Points in view i, px, and which of them were aligned.
    """
    dtype = points_i.dtype
    one, other = view_i.astype(jnp.float32), view_j.astype(jnp.float32)
    start, points_j, i_from_j = points_i.astype(jnp.float32), points_j.astype(jnp.float32), i_from_j.astype(jnp.float32)
    offset = jnp.arange(-RADIUS - 1, RADIUS + 2, dtype=jnp.float32)
    grid = jnp.stack(jnp.meshgrid(offset, offset), -1)
    weight = jnp.exp(-jnp.sum(grid[1:-1, 1:-1] ** 2, -1) / (2 * SPREAD_PX**2))
    weight = weight / weight.sum()

    # A patch is so small that the homography is affine over it: point + A offset, A from central differences.
    middle, inverse = apply(i_from_j, points_j), jnp.linalg.inv(i_from_j)
    axes = jnp.eye(2, dtype=jnp.float32)
    affine = [(apply(inverse, middle + axis[None]) - apply(inverse, middle - axis[None])) / 2 for axis in axes]
    back = points_j[:, None, None, :] + sum(
        column[:, None, None, :] * grid[None, :, :, k, None] for k, column in enumerate(affine)
    )
    template = _bilinear(other, back)
    gx = (template[:, 1:-1, 2:] - template[:, 1:-1, :-2]) / 2
    gy = (template[:, 2:, 1:-1] - template[:, :-2, 1:-1]) / 2
    template = template[:, 1:-1, 1:-1]
    template = template - jnp.sum(template * weight[None], (1, 2), keepdims=True)

    def total(a, b):
        return jnp.sum(a * b * weight[None], (1, 2))

    # With the template centred, all that a round needs of a patch are four sums over it.
    one_ = jnp.ones_like(template)
    xx, xy, yy, energy = total(gx, gx), total(gx, gy), total(gy, gy), total(template, template)
    mean_x, mean_y, own_x, own_y = total(gx, one_), total(gy, one_), total(gx, template), total(gy, template)
    sums = jnp.stack([one_, template, gx, gy]) * weight[None, None]
    determinant = jnp.maximum(xx * yy - xy * xy, 1e-9)

    def step(points, _):
        mean, similar, along_x, along_y = jnp.sum(_around(one, points)[None] * sums, (2, 3))
        gain = jnp.maximum(similar / jnp.maximum(energy, 1e-9), LEAST_GAIN)
        bx, by = own_x - (along_x - mean * mean_x) / gain, own_y - (along_y - mean * mean_y) / gain
        move = jnp.stack([yy * bx - xy * by, xx * by - xy * bx], -1) / determinant[:, None]
        return points + jnp.clip(move, -1.0, 1.0), None

    points, _ = jax.lax.scan(step, start, None, length=ROUNDS)
    height, width = view_i.shape
    margin = RADIUS + 1
    high = jnp.array([width - 1 - margin, height - 1 - margin])
    inside = jnp.all((start >= margin) & (start <= high[None]), 1)
    whole = jnp.all((back >= 0) & (back <= jnp.array([width - 1, height - 1])), (1, 2, 3))
    found = inside & whole & (jnp.sum((points - start) ** 2, 1) < MOST_PX**2)
    return jnp.where(found[:, None], points.astype(dtype), points_i), found
