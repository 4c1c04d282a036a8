"""Blobs of a floor view in JAX: local maxima of the determinant of the Hessian, fixed-size, spread, sub-pixel.

    L = G_sigma * view,    response = max(L_xx L_yy - L_xy^2, 0) sigma^4

(Beaudet 1978; Lindeberg, "Feature detection with automatic scale selection", IJCV 1998, at one scale.) Stains, flecks,
pores and bends of a vein are found again from the other side, in other light and blur, far more often than corners.
What is not seen does not count: the average is taken over what is.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

SIGMA_PX = 2.0
BORDER_PX = 6
MAX_STEP_PX = 0.75
SHARE, LEAST = 1e-4, 1e-7
"""A blob responds more than this share of the strongest, and more than rounding does: a tenth of a grey level."""


def _smoothing(size: int, dtype: jnp.dtype) -> Float[Array, "n n"]:
    """The Gaussian as a matrix: of the rows of a view of so many px."""
    offset = np.arange(size)
    kernel = np.exp(-0.5 * ((offset[:, None] - offset[None, :]) / SIGMA_PX) ** 2)
    return jnp.asarray(kernel / kernel.sum(1).max(), dtype)


def smooth(grey: Float[Array, "H W"], seen: Bool[Array, "H W"]) -> Float[Array, "H W"]:
    """The Gaussian average of what is seen around each pixel."""
    down, across = (_smoothing(length, grey.dtype) for length in grey.shape)
    weight = seen.astype(grey.dtype)
    # The difference from the mean: in float32 a response is a small difference of products.
    mean = jnp.sum(grey * weight) / jnp.maximum(weight.sum(), 1)

    def blur(values):
        return jnp.matmul(jnp.matmul(down, values, precision="highest"), across.T, precision="highest")

    return blur((grey - mean) * weight) / jnp.maximum(blur(weight), 1e-3)


def responses(grey: Float[Array, "H W"], seen: Bool[Array, "H W"]) -> Float[Array, "H W"]:
    """The determinant of the Hessian where it is above 0: grey levels squared."""
    padded = jnp.pad(smooth(grey, seen), 1, mode="edge")
    middle = padded[1:-1, 1:-1]
    xx = padded[1:-1, 2:] + padded[1:-1, :-2] - 2 * middle
    yy = padded[2:, 1:-1] + padded[:-2, 1:-1] - 2 * middle
    xy = (padded[2:, 2:] - padded[2:, :-2] - padded[:-2, 2:] + padded[:-2, :-2]) / 4
    return jnp.maximum(xx * yy - xy**2, 0) * SIGMA_PX**4


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


def find_blobs(
    grey: Float[Array, "H W"], seen: Bool[Array, "H W"], *, count: int = 400, radius: int = 3
) -> tuple[Float[Array, "K 2"], Float[Array, "K"], Bool[Array, "K"]]:
    """The strongest blobs, refined to a fraction of a pixel.

    Args:
      grey: in [0, 1].
      seen: the field of view.
      count: how many rows are returned.
      radius: of the non-maximum suppression, px.

    Returns:
      Points (x, y) px, responses, and which rows hold a blob.
    """
    everywhere = responses(grey, seen)
    response = jnp.where(erode(seen, BORDER_PX), everywhere, 0)
    local_maximum = _running(response, radius, jnp.maximum, -jnp.inf)
    peaks = jnp.where((response >= local_maximum) & (response > 0), response, 0)
    strength, index = jax.lax.top_k(peaks.reshape(-1), min(count, peaks.size))
    row, column = index // grey.shape[1], index % grey.shape[1]
    points = jnp.stack([column, row], -1) + _newton_step(everywhere, row, column)
    # Not strength[0]: a slice of its result makes XLA sort the whole view instead of selecting.
    valid = strength > jnp.maximum(SHARE * jnp.max(peaks), LEAST)
    return points.astype(grey.dtype), strength, valid


def _newton_step(response: Float[Array, "H W"], row: Int[Array, " K"], column: Int[Array, " K"]) -> Float[Array, "K 2"]:
    """From a pixel to the top (x, y) of a paraboloid through the responses around it; nothing where it has none."""
    offset = jnp.arange(-1, 2, dtype=row.dtype)
    y = jnp.clip(row[:, None] + offset[None, :], 0, response.shape[0] - 1)[:, :, None]
    x = jnp.clip(column[:, None] + offset[None, :], 0, response.shape[1] - 1)[:, None, :]
    f = response[y, x]
    # Of unit height: products of three small responses would vanish.
    f = f / jnp.maximum(f[:, 1:2, 1:2], 1e-20)
    gx, gy = (f[:, 1, 2] - f[:, 1, 0]) / 2, (f[:, 2, 1] - f[:, 0, 1]) / 2
    hxx, hyy = f[:, 1, 2] - 2 * f[:, 1, 1] + f[:, 1, 0], f[:, 2, 1] - 2 * f[:, 1, 1] + f[:, 0, 1]
    hxy = (f[:, 2, 2] - f[:, 2, 0] - f[:, 0, 2] + f[:, 0, 0]) / 4
    determinant = hxx * hyy - hxy * hxy
    peak = (hxx < 0) & (determinant > 0)
    scale = jnp.where(peak, 1 / jnp.where(peak, determinant, 1), 0)
    step = jnp.stack([hxy * gy - hyy * gx, hxy * gx - hxx * gy], -1) * scale[:, None]
    return jnp.clip(step, -MAX_STEP_PX, MAX_STEP_PX)
