"""Where a corner of one floor view lies in another, to a few hundredths of a pixel: aligned patches, not two corners.

A corner is a peak of contrast, and contrast falls with the distance from the camera. So a corner is found a little
nearer than what makes it, the farther the more, and steps come out short, which adds up. The patch around it has no
such pull, and says more (Lucas and Kanade, 1981).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, UInt8

from ebjax.geometry.homography import apply, slopes

RADIUS = 5
SIDE = 2 * RADIUS + 1
SPREAD_PX = 3.0
"""Standard deviation of the window's weights."""
ROUNDS = 3
MOST_PX = 1.5
"""A corner that moves farther than this has found something else, and stays where it was."""
LEAST_GAIN = 0.2
"""Of a patch's contrast in the one view over that in the other."""
FLAT = 1e-4
"""Squared gradients, product of both directions, of a patch that shows nothing."""
LEAST_PX, NOISE, CORNER_PX = 0.2, 0.3, 0.6
"""Standard deviations up to one factor a pair: of any aligned patch, px; of the grey level that a patch tells; of a
corner that was not aligned, px."""


def aligned(
    view_i: UInt8[Array, "h w"],
    view_j: UInt8[Array, "h w"],
    seen: Bool[Array, "h w"],
    i_from_j: Float[Array, "3 3"],
    points_i: Float[Array, "M 2"],
    points_j: Float[Array, "M 2"],
) -> tuple[Float[Array, "M 2"], Float[Array, "M 2 2"], Bool[Array, " M"]]:
    """Points of view i moved to where the patches around their partners of view j fit best.

    Brightness and contrast of a patch may differ between the views.

    Args:
      view_i: grey.
      view_j: grey, of the same floor.
      seen: what views show of the floor; a patch that reaches beyond it is left alone.
      i_from_j: pixels of view i from pixels of view j, right to about a pixel; turns and scales the patches.
      points_i: (x, y) px in view i.
      points_j: their partners in view j, px.

    Returns:
      Points in view i, px; their covariance up to a factor that all share, px^2, wide along an edge or a grain, where
      a patch tells little; and which of them were aligned.
    """
    if min(view_i.shape) <= SIDE:
        alone = jnp.broadcast_to(CORNER_PX**2 * jnp.eye(2, dtype=points_i.dtype), (len(points_i), 2, 2))
        return points_i, alone, jnp.zeros(len(points_i), bool)
    image = view_i.astype(jnp.float32)
    start, partners, homography = (jnp.asarray(x, jnp.float32) for x in (points_i, points_j, i_from_j))
    offset = jnp.arange(-RADIUS - 1, RADIUS + 2, dtype=jnp.float32)
    grid = jnp.stack(jnp.meshgrid(offset, offset), -1)
    weight = jnp.exp(-jnp.sum(grid[1:-1, 1:-1] ** 2, -1) / (2 * SPREAD_PX**2))
    weight = (weight / weight.sum())[None]

    # A patch is so small that the homography is affine over it.
    affine = slopes(jnp.linalg.inv(homography), apply(homography, partners))
    back = partners[:, None, None, :] + jnp.einsum("mab,ijb->mija", affine, grid)
    wide = _bilinear(view_j.astype(jnp.float32), back)
    gx = (wide[:, 1:-1, 2:] - wide[:, 1:-1, :-2]) / 2
    gy = (wide[:, 2:, 1:-1] - wide[:, :-2, 1:-1]) / 2
    across_m, down_m = grid[None, 1:-1, 1:-1, 0], grid[None, 1:-1, 1:-1, 1]

    def total(a, b):
        return jnp.sum(a * b * weight, (1, 2))

    def level(patch):
        """Without its mean and its slopes: light and vignetting stay with the camera while the floor moves."""
        spread = jnp.sum(across_m**2 * weight)
        mean, x, y = (total(patch, one)[:, None, None] for one in (1.0, across_m, down_m))
        return patch - mean - (x * across_m + y * down_m) / spread

    # What is level is orthogonal to what light adds, so the other view needs none of it taken away.
    gx, gy, template = level(gx), level(gy), level(wide[:, 1:-1, 1:-1])
    xx, xy, yy, energy = total(gx, gx), total(gx, gy), total(gy, gy), total(template, template)
    own_x, own_y = total(gx, template), total(gy, template)
    sums = jnp.stack([template, gx, gy]) * weight[None]
    determinant = jnp.maximum(xx * yy - xy * xy, FLAT)

    def step(points, _):
        similar, along_x, along_y = jnp.sum(_around(image, points)[None] * sums, (2, 3))
        gain = jnp.maximum(similar / jnp.maximum(energy, 1e-9), LEAST_GAIN)
        bx, by = own_x - along_x / gain, own_y - along_y / gain
        move = jnp.stack([yy * bx - xy * by, xx * by - xy * bx], -1) / determinant[:, None]
        return points + jnp.clip(move, -1.0, 1.0), None

    moved, _ = jax.lax.scan(step, start, None, length=ROUNDS)
    ends = jnp.array([0, -1, 0, -1]), jnp.array([0, 0, -1, -1])
    around = start[:, None, :] + (RADIUS + 2) * jnp.sign(grid[ends])[None]
    whole = _inside(seen, around) & _inside(seen, back[:, *ends])
    found = whole & (jnp.sum((moved - start) ** 2, 1) < MOST_PX**2)
    eye = jnp.eye(2, dtype=jnp.float32)[None]
    rows = jnp.stack([jnp.stack([yy, -xy], -1), jnp.stack([-xy, xx], -1)], -2)
    inverse_gradients = rows / jnp.maximum(xx * yy - xy * xy, FLAT)[:, None, None]
    covariance = jnp.where(found[:, None, None], LEAST_PX**2 * eye + NOISE**2 * inverse_gradients, CORNER_PX**2 * eye)
    kept = jnp.where(found[:, None], moved.astype(points_i.dtype), points_i)
    return kept, covariance.astype(points_i.dtype), found


def _bilinear(image: Float[Array, "h w"], points: Float[Array, "*n 2"]) -> Float[Array, " *n"]:
    """Values at points, anyhow outside: half the time of `geometry.warp.sample_bilinear`, which fades there."""
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
    """Square patches around points: cut out whole, which is faster than a gather, and shifted by the fraction."""
    corner = jnp.floor(points)
    x, y = (points - corner)[:, 0, None, None], (points - corner)[:, 1, None, None]
    first = corner.astype(jnp.int32) - RADIUS

    def cut(at):
        return jax.lax.dynamic_slice(image, (at[1], at[0]), (SIDE + 1, SIDE + 1))

    patch = jax.vmap(cut)(first)
    rows = (1 - y) * patch[:, :-1] + y * patch[:, 1:]
    return (1 - x) * rows[:, :, :-1] + x * rows[:, :, 1:]


def _inside(seen: Bool[Array, "h w"], points: Float[Array, "M k 2"]) -> Bool[Array, " M"]:
    """Whether all k points lie on what is seen."""
    height, width = seen.shape
    high = jnp.array([width - 1, height - 1], points.dtype)[None, None]
    nearest = jnp.clip(jnp.round(points), 0, high).astype(jnp.int32)
    return jnp.all((points >= 0) & (points <= high), (1, 2)) & jnp.all(seen[nearest[..., 1], nearest[..., 0]], 1)
