"""Where a keypoint of one floor view lies in another, to a few hundredths of a pixel: aligned patches, not keypoints.

A keypoint is a peak of contrast, and contrast falls with the distance from the camera. So it is found a little nearer
than what makes it, the farther the more, and steps come out short, which adds up. The patch around it has no such pull,
and says more (Lucas and Kanade, 1981).
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
"""A keypoint that moves farther than this has found something else, and stays where it was."""
LEAST_GAIN = 0.2
"""Of a patch's contrast in the one view over that in the other."""
FLAT = 1e-4
"""Squared gradients, product of both directions, of a patch that shows nothing."""
LEAST_PX, NOISE, ALONE_PX = 0.2, 0.3, 0.6
"""Standard deviations up to one factor a pair: of any aligned patch, px; of the grey level that a patch tells; of a
keypoint that was not aligned, px."""


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
        alone = jnp.broadcast_to(ALONE_PX**2 * jnp.eye(2, dtype=points_i.dtype), (len(points_i), 2, 2))
        return points_i, alone, jnp.zeros(len(points_i), bool)
    image = view_i.astype(jnp.float32)
    start, partners, homography = (jnp.asarray(x, jnp.float32) for x in (points_i, points_j, i_from_j))
    # Matches are the last axis of all patches: sums over a patch then run over many of them at once.
    offset = jnp.arange(-RADIUS - 1, RADIUS + 2, dtype=jnp.float32)
    wide_x, wide_y = offset[None, :, None], offset[:, None, None]
    across, down = wide_x[:, 1:-1], wide_y[1:-1]
    bell = jnp.exp(-(offset[1:-1] ** 2) / (2 * SPREAD_PX**2))
    bell = bell / bell.sum()
    weight = bell[:, None, None] * bell[None, :, None]

    # A patch is so small that the homography is affine over it.
    affine = slopes(jnp.linalg.inv(homography), apply(homography, partners))
    turned = [affine[None, None, :, k, 0] * wide_x + affine[None, None, :, k, 1] * wide_y for k in (0, 1)]
    x, y = (partners[None, None, :, k] + turned[k] for k in (0, 1))
    wide = _bilinear(view_j, x, y)
    gx = (wide[1:-1, 2:] - wide[1:-1, :-2]) / 2
    gy = (wide[2:, 1:-1] - wide[:-2, 1:-1]) / 2

    def total(patch):
        return jnp.sum(patch * weight, (0, 1))[None, None]

    def level(patch):
        """Without its mean and its slopes: light and vignetting stay with the camera while the floor moves."""
        slope = total(patch * across) * across + total(patch * down) * down
        return patch - total(patch) - slope / jnp.sum(offset[1:-1] ** 2 * bell)

    # What is level is orthogonal to what light adds, so the other view needs none of it taken away.
    gx, gy, template = level(gx), level(gy), level(wide[1:-1, 1:-1])
    xx, xy, yy, energy = (total(a * b)[0, 0] for a, b in ((gx, gx), (gx, gy), (gy, gy), (template, template)))
    own_x, own_y = total(gx * template)[0, 0], total(gy * template)[0, 0]
    determinant = jnp.maximum(xx * yy - xy * xy, FLAT)

    def step(points, _):
        patch = _around(image, points)
        similar, along_x, along_y = (total(patch * own)[0, 0] for own in (template, gx, gy))
        gain = jnp.maximum(similar / jnp.maximum(energy, 1e-9), LEAST_GAIN)
        bx, by = own_x - along_x / gain, own_y - along_y / gain
        move = jnp.stack([yy * bx - xy * by, xx * by - xy * bx], -1) / determinant[:, None]
        return points + jnp.clip(move, -1.0, 1.0), None

    moved, _ = jax.lax.scan(step, start, None, length=ROUNDS)
    edge = jnp.array([0, 0, -1, -1]), jnp.array([0, -1, 0, -1])
    own = jnp.stack([offset[edge[1]], offset[edge[0]]], -1)[:, None] * (RADIUS + 2) / (RADIUS + 1) + start[None]
    whole = _inside(seen, own) & _inside(seen, jnp.stack([x[edge], y[edge]], -1))
    found = whole & (jnp.sum((moved - start) ** 2, 1) < MOST_PX**2)
    eye = jnp.eye(2, dtype=jnp.float32)[None]
    rows = jnp.stack([jnp.stack([yy, -xy], -1), jnp.stack([-xy, xx], -1)], -2)
    covariance = LEAST_PX**2 * eye + NOISE**2 * rows / determinant[:, None, None]
    covariance = jnp.where(found[:, None, None], covariance, ALONE_PX**2 * eye)
    kept = jnp.where(found[:, None], moved.astype(points_i.dtype), points_i)
    return kept, covariance.astype(points_i.dtype), found


def _bilinear(image: UInt8[Array, "h w"], x: Float[Array, " *n"], y: Float[Array, " *n"]) -> Float[Array, " *n"]:
    """Values at points, anyhow outside.

    A gather costs by the element, so one word holds a pixel and its three neighbours; `geometry.warp.sample_bilinear`
    takes any image and fades outside.
    """
    height, width = image.shape
    pixel = image.astype(jnp.uint32)
    pair = pixel | jnp.roll(pixel, -1, 1) << 8
    four = pair | jnp.roll(pair, -1, 0) << 16
    left, top = jnp.floor(x), jnp.floor(y)
    column = jnp.clip(left.astype(jnp.int32), 0, width - 2)
    row = jnp.clip(top.astype(jnp.int32), 0, height - 2)
    word = four.reshape(-1).at[row * width + column].get(mode="promise_in_bounds")
    a, b, c, d = ((word >> shift & 255).astype(jnp.float32) for shift in (0, 8, 16, 24))
    above, below = a + (x - left) * (b - a), c + (x - left) * (d - c)
    return above + (y - top) * (below - above)


def _around(image: Float[Array, "h w"], points: Float[Array, "M 2"]) -> Float[Array, "side side M"]:
    """Square patches around points: cut out whole, which is faster than a gather, and shifted by the fraction."""
    corner = jnp.floor(points)
    x, y = (points - corner).T[:, None, None]
    first = corner.astype(jnp.int32) - RADIUS

    def cut(at):
        return jax.lax.dynamic_slice(image, (at[1], at[0]), (SIDE + 1, SIDE + 1))

    patch = jnp.moveaxis(jax.vmap(cut)(first), 0, -1)
    rows = (1 - y) * patch[:-1] + y * patch[1:]
    return (1 - x) * rows[:, :-1] + x * rows[:, 1:]


def _inside(seen: Bool[Array, "h w"], points: Float[Array, "k M 2"]) -> Bool[Array, " M"]:
    """Whether all k points lie on what is seen."""
    height, width = seen.shape
    high = jnp.array([width - 1, height - 1], points.dtype)[None, None]
    nearest = jnp.clip(jnp.round(points), 0, high).astype(jnp.int32)
    within = jnp.all((points >= 0) & (points <= high), -1)
    return jnp.all(within & seen[nearest[..., 1], nearest[..., 0]], 0)
