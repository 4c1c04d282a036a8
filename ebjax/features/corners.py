"""Shi-Tomasi corners of a floor view in JAX: fixed-size, spread, sub-pixel ("Good features to track", CVPR 1994)."""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

WINDOW = (0.25, 0.5, 0.25)


def _blur(image: Float[Array, "H W"], times: int) -> Float[Array, "H W"]:
    for _ in range(times):
        for axis in (0, 1):
            pad = [(1, 1) if axis == a else (0, 0) for a in (0, 1)]
            p = jnp.pad(image, pad, mode="edge")
            n = image.shape[axis]
            parts = [w * jax.lax.slice_in_dim(p, k, k + n, axis=axis) for k, w in enumerate(WINDOW)]
            image = parts[0] + parts[1] + parts[2]
    return image


def corner_response(grey: Float[Array, "H W"], seen: Bool[Array, "H W"]) -> Float[Array, "H W"]:
    """The smaller eigenvalue of the structure tensor over about 5 x 5 pixels; 0 near the edge of the seen part."""
    smooth = _blur(jnp.where(seen, grey, 0), 1)
    gx = jnp.pad((smooth[:, 2:] - smooth[:, :-2]) / 2, ((0, 0), (1, 1)))
    gy = jnp.pad((smooth[2:] - smooth[:-2]) / 2, ((1, 1), (0, 0)))
    xx, xy, yy = (_blur(product, 2) for product in (gx * gx, gx * gy, gy * gy))
    response = (xx + yy) / 2 - jnp.sqrt(((xx - yy) / 2) ** 2 + xy**2 + 1e-20)
    return jnp.where(erode(seen, 6), response, 0)


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
    """The strongest local maxima of the corner response, refined by one parabola per axis.

    Args:
      grey: in [0, 1].
      seen: the field of view.
      count: how many rows are returned.
      radius: of the non-maximum suppression, px.

    Returns:
      Points (x, y) px, responses, and which rows hold a corner (at least 1e-4 of the strongest response).
    """
    response = corner_response(grey, seen)
    local_maximum = _running(response, radius, jnp.maximum, -jnp.inf)
    peaks = jnp.where((response >= local_maximum) & (response > 0), response, 0)
    strength, index = jax.lax.top_k(peaks.reshape(-1), min(count, peaks.size))
    width = grey.shape[1]
    y, x = index // width, index % width

    def refine(before, at, after):
        curvature = before - 2 * at + after
        return jnp.where(curvature < 0, jnp.clip(0.5 * (before - after) / curvature, -0.5, 0.5), 0)

    read = lambda dy, dx: response[jnp.clip(y + dy, 0, grey.shape[0] - 1), jnp.clip(x + dx, 0, width - 1)]  # noqa: E731
    at = read(0, 0)
    points = jnp.stack([x + refine(read(0, -1), at, read(0, 1)), y + refine(read(-1, 0), at, read(1, 0))], -1)
    valid = strength > jnp.maximum(1e-4 * strength[0], 1e-12)
    return points.astype(grey.dtype), strength, valid
