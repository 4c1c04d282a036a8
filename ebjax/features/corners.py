"""Shi-Tomasi corners of a floor view in JAX: fixed-size, spread, sub-pixel ("Good features to track", CVPR 1994)."""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

WINDOW = (0.25, 0.5, 0.25)
BORDER_PX = 6
MAX_STEP_PX = 0.75


def _blur(image: Float[Array, "H W"], times: int) -> Float[Array, "H W"]:
    for _ in range(times):
        for axis in (0, 1):
            pad = [(1, 1) if axis == a else (0, 0) for a in (0, 1)]
            p = jnp.pad(image, pad, mode="edge")
            n = image.shape[axis]
            parts = [w * jax.lax.slice_in_dim(p, k, k + n, axis=axis) for k, w in enumerate(WINDOW)]
            image = parts[0] + parts[1] + parts[2]
    return image


def structure_tensor(grey: Float[Array, "H W"], seen: Bool[Array, "H W"]) -> tuple[Array, Array, Array]:
    """Products of the gradient g_x g_x, g_x g_y, g_y g_y, summed over about 5 x 5 pixels."""
    smooth = _blur(jnp.where(seen, grey, 0), 1)
    gx = jnp.pad((smooth[:, 2:] - smooth[:, :-2]) / 2, ((0, 0), (1, 1)))
    gy = jnp.pad((smooth[2:] - smooth[:-2]) / 2, ((1, 1), (0, 0)))
    return _blur(gx * gx, 2), _blur(gx * gy, 2), _blur(gy * gy, 2)


def smaller_eigenvalue(
    xx: Float[Array, "H W"], xy: Float[Array, "H W"], yy: Float[Array, "H W"]
) -> Float[Array, "H W"]:
    """Of the matrix [[xx, xy], [xy, yy]]."""
    return (xx + yy) / 2 - jnp.sqrt(((xx - yy) / 2) ** 2 + xy**2 + 1e-20)


def _running(image: Float[Array, "H W"], radius: int, combine, fill: float) -> Float[Array, "H W"]:
    """The maximum or minimum over a square, by two passes of shifted copies (reduce_window is 30 times slower)."""
    for axis in (0, 1):
        pad = [(radius, radius) if axis == a else (0, 0) for a in (0, 1)]
        padded, n = jnp.pad(image, pad, constant_values=fill), image.shape[axis]
        image = functools.reduce(
            combine, [jax.lax.slice_in_dim(padded, k, k + n, axis=axis) for k in range(2 * radius + 1)]
        )
    return image


def erode(seen: Bool[Array, "H W"], radius: int) -> Bool[Array, "H W"]:
    """Leaves out what is closer than `radius` px to something unseen or to the border."""
    return _running(seen.astype(jnp.float32), radius, jnp.minimum, 0.0) > 0.5


def find_corners(
    grey: Float[Array, "H W"], seen: Bool[Array, "H W"], *, count: int = 400, radius: int = 3
) -> tuple[Float[Array, "K 2"], Float[Array, "K"], Bool[Array, "K"]]:
    """The strongest local maxima of the corner response, refined to a fraction of a pixel.

    Args:
      grey: in [0, 1].
      seen: the field of view.
      count: how many rows are returned.
      radius: of the non-maximum suppression, px.

    Returns:
      Points (x, y) px, responses, and which rows hold a corner (at least 1e-4 of the strongest response).
    """
    xx, xy, yy = structure_tensor(grey, seen)
    response = jnp.where(erode(seen, BORDER_PX), smaller_eigenvalue(xx, xy, yy), 0)
    local_maximum = _running(response, radius, jnp.maximum, -jnp.inf)
    peaks = jnp.where((response >= local_maximum) & (response > 0), response, 0)
    strength, index = jax.lax.top_k(peaks.reshape(-1), min(count, peaks.size))
    row, column = index // grey.shape[1], index % grey.shape[1]
    points = jnp.stack([column, row], -1) + _newton_step(xx, xy, yy, row, column)
    # Not strength[0]: a slice of its result makes XLA sort the whole view instead of selecting.
    valid = strength > jnp.maximum(1e-4 * jnp.max(peaks), 1e-12)
    return points.astype(grey.dtype), strength, valid


def _newton_step(
    xx: Float[Array, "H W"],
    xy: Float[Array, "H W"],
    yy: Float[Array, "H W"],
    row: Int[Array, " K"],
    column: Int[Array, " K"],
) -> Float[Array, "K 2"]:
    """From a pixel to the top (x, y) of a paraboloid through log(det / trace) around it; nothing where it has none.

    The smaller eigenvalue has creases where the two swap; det / trace is smooth and peaks at the same place.
    """
    offset = jnp.arange(-1, 2, dtype=row.dtype)
    y = jnp.clip(row[:, None] + offset[None, :], 0, xx.shape[0] - 1)[:, :, None]
    x = jnp.clip(column[:, None] + offset[None, :], 0, xx.shape[1] - 1)[:, None, :]
    xx, xy, yy = xx[y, x], xy[y, x], yy[y, x]
    f = jnp.log(jnp.maximum(xx * yy - xy * xy, 0) / (xx + yy + 1e-12) + 1e-9)
    gx, gy = (f[:, 1, 2] - f[:, 1, 0]) / 2, (f[:, 2, 1] - f[:, 0, 1]) / 2
    hxx, hyy = f[:, 1, 2] - 2 * f[:, 1, 1] + f[:, 1, 0], f[:, 2, 1] - 2 * f[:, 1, 1] + f[:, 0, 1]
    hxy = (f[:, 2, 2] - f[:, 2, 0] - f[:, 0, 2] + f[:, 0, 0]) / 4
    determinant = hxx * hyy - hxy * hxy
    peak = (hxx < 0) & (determinant > 0)
    scale = jnp.where(peak, 1 / jnp.where(peak, determinant, 1), 0)
    step = jnp.stack([hxy * gy - hyy * gx, hxy * gx - hxx * gy], -1) * scale[:, None]
    return jnp.clip(step, -MAX_STEP_PX, MAX_STEP_PX)
