"""Upright rootSIFT in JAX, dense or at keypoints, without weights (Lowe 2004; Arandjelovic and Zisserman 2012).

A grey image becomes a map of pooled gradient orientations (`pool_orientations`); a descriptor anywhere is sixteen
bilinear reads of that map (`describe`). The pooling is two matrix products: fast, and differentiable.
No orientation is estimated: floor views are aligned by R_pi, and upright descriptors are the more distinctive ones.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ebjax.geometry.pytree import pytree

ORIENTATIONS = 8
BINS = 4
DIMENSION = BINS * BINS * ORIENTATIONS
ROOT_FLOOR = 1e-12


@pytree
class OrientationMap:
    """Gradient orientations pooled by a triangle of half-width `bin_px` on a grid of `stride_px`, bin_px = 3 stride_px.

    The grid is symmetric about the image's centre and reaches beyond its border, so turning by pi and pooling commute.
    """

    values: Float[Array, "h w 9"]  # eight orientations and the share of pixels seen
    stride_px: float = dataclasses.field(metadata=dict(static=True))
    origin_px: tuple[float, float] = dataclasses.field(metadata=dict(static=True))  # x, y of the first grid point


def _gaussian_matrix(size: int, sigma: float) -> np.ndarray:
    offset = np.arange(size)
    kernel = np.exp(-0.5 * ((offset[:, None] - offset[None, :]) / sigma) ** 2)
    return (kernel / kernel.sum(1, keepdims=True)).astype(np.float32)


def _centres(size: int, stride_px: float) -> np.ndarray:
    count = int(np.ceil((size - 1) / stride_px)) + 1
    return (size - 1) / 2 + (np.arange(count) - (count - 1) / 2) * stride_px


def _pooling_matrix(size: int, bin_px: float) -> np.ndarray:
    centres = _centres(size, bin_px / 3)
    weights = np.maximum(0, 1 - np.abs(centres[:, None] - np.arange(size)[None, :]) / bin_px)
    return (weights / bin_px).astype(np.float32)


def pool_orientations(
    grey: Float[Array, "H W"], seen: Float[Array, "H W"], bin_px: float, sigma_px: float = 1.0
) -> OrientationMap:
    """Pools the gradient of a grey image by orientation.

    Args:
      grey: in [0, 1].
      seen: 1 where the view shows the floor, 0 outside the camera's field of view. Gradients count only where their
        whole neighbourhood is seen, so the border of the field of view leaves no edge.
      bin_px: side of one of the 4 x 4 spatial bins, px; the descriptor covers 4 bin_px.
      sigma_px: Gaussian smoothing before the gradient, px.
    """
    height, width = grey.shape
    dtype = grey.dtype
    smooth_y, smooth_x = (jnp.asarray(_gaussian_matrix(n, sigma_px), dtype) for n in (height, width))
    smooth = smooth_y @ (grey * seen) @ smooth_x.T
    weight = smooth_y @ seen @ smooth_x.T
    inside = (weight > 0.999).astype(dtype)
    smooth = smooth / jnp.maximum(weight, 1e-3)
    gx = jnp.pad((smooth[:, 2:] - smooth[:, :-2]) / 2, ((0, 0), (1, 1)))
    gy = jnp.pad((smooth[2:] - smooth[:-2]) / 2, ((1, 1), (0, 0)))
    # Exactly nothing where there is no gradient (and no infinite derivative): else flat floor would have a direction.
    squared = gx * gx + gy * gy
    some = squared > 0
    magnitude = jnp.where(some, jnp.sqrt(jnp.where(some, squared, 1)), 0) * inside
    angle = jnp.arctan2(gy, jnp.where(some, gx, 1)) * (ORIENTATIONS / (2 * np.pi))
    distance = jnp.abs(angle[..., None] - jnp.arange(ORIENTATIONS, dtype=dtype)[None, None, :])
    distance = jnp.minimum(distance, jnp.abs(ORIENTATIONS - distance))
    channels = jnp.maximum(0, 1 - distance) * magnitude[..., None]
    channels = jnp.concatenate([channels, inside[..., None]], -1)
    pool_y, pool_x = (jnp.asarray(_pooling_matrix(n, bin_px), dtype) for n in (height, width))
    rows = (pool_y @ channels.reshape(height, -1)).reshape(-1, width, ORIENTATIONS + 1)
    values = jnp.einsum("hwc,kw->hkc", rows, pool_x)
    origin = float(_centres(width, bin_px / 3)[0]), float(_centres(height, bin_px / 3)[0])
    return OrientationMap(values, bin_px / 3, origin)


def describe(
    pooled: OrientationMap, points: Float[Array, "N 2"], root_floor: float = ROOT_FLOOR
) -> tuple[Float[Array, "N 128"], Float[Array, "N"]]:
    """Upright rootSIFT at any points: L2, clip at 0.2, L1, square root; unit length.

    Args:
      pooled: from `pool_orientations`.
      points: (x, y), px of the image that was pooled.
      root_floor: as in `root_normalise`.

    Returns:
      Descriptors, zero where nothing is seen, and the share of their support inside the field of view, in [0, 1].
    """
    values, dtype = pooled.values, pooled.values.dtype
    offset = (jnp.arange(BINS, dtype=dtype) - (BINS - 1) / 2) * 3
    height, width, channels = values.shape
    x = (points[:, 0, None] - pooled.origin_px[0]) / pooled.stride_px + offset[None, :]
    y = (points[:, 1, None] - pooled.origin_px[1]) / pooled.stride_px + offset[None, :]
    flat = values.reshape(-1, channels)

    def taps(position: Float[Array, "N 4"], size: int):
        low = jnp.floor(position)
        share = position - low
        index = jnp.stack([low, low + 1], -1).astype(jnp.int32)
        weight = jnp.stack([1 - share, share], -1) * ((index >= 0) & (index < size)).astype(dtype)
        return jnp.clip(index, 0, size - 1), weight

    (iy, wy), (ix, wx) = taps(y, height), taps(x, width)
    index = iy[:, :, None, :, None] * width + ix[:, None, :, None, :]
    weight = wy[:, :, None, :, None] * wx[:, None, :, None, :]
    bins = jnp.sum(flat[index] * weight[..., None], axis=(3, 4))
    gaussian = jnp.exp(-((offset / 3) ** 2) / (2 * (BINS / 2) ** 2))
    window = gaussian[:, None] * gaussian[None, :]
    support = jnp.sum(bins[..., -1] * window[None], axis=(1, 2)) / jnp.sum(window)
    histogram = (bins[..., :-1] * window[None, :, :, None]).reshape(-1, DIMENSION)
    return root_normalise(histogram, root_floor), support


def root_normalise(histogram: Float[Array, "*n D"], root_floor: float = ROOT_FLOOR) -> Float[Array, "*n D"]:
    """SIFT's normalisation and the Hellinger root: unit L2 length; all-zero rows stay zero.

    Args:
      histogram: orientations, not negative.
      root_floor: sqrt(share + floor) - sqrt(floor) is at most 1 / (2 sqrt(floor)) steep, at empty bins. The default
        leaves the root as it is; who differentiates it wants 1e-4 or so (a bin's share is 1/128 on average), or empty
        bins, which are many, drown all others.
    """
    tiny = jnp.asarray(1e-12, histogram.dtype)
    unit = histogram / jnp.sqrt(jnp.sum(histogram**2, -1, keepdims=True) + tiny)
    clipped = jnp.minimum(unit, 0.2)
    share = clipped / (jnp.sum(clipped, -1, keepdims=True) + 1e-6)
    floor = jnp.asarray(root_floor, histogram.dtype)
    return jnp.sqrt(share + floor) - jnp.sqrt(floor)


def rotate_pi_descriptor(descriptors: Float[Array, "*n 128"]) -> Float[Array, "*n 128"]:
    """The descriptors of the same points in the image turned by pi: bins reversed, orientations half a turn on."""
    bins = descriptors.reshape(*descriptors.shape[:-1], BINS, BINS, ORIENTATIONS)
    turned = jnp.roll(bins[..., ::-1, ::-1, :], ORIENTATIONS // 2, axis=-1)
    return turned.reshape(descriptors.shape)
