"""Bilinear sampling of images, HWC or NHWC, float in [0, 1] or uint8.

Pixel centres are at integers, the top-left one at (0, 0) (torch: align_corners=True). Zero outside: a tap that
falls off the image counts as 0, so the border fades over one pixel. uint8 images are gathered as bytes and come out as
float32 in [0, 1]. Target pixels behind the camera are not masked here: see `camera.field_of_view`.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Shaped, UInt8

from ebjax.geometry.homography import Arrays, safe_denominator

Pixels = Float[Arrays, "H W C"] | UInt8[Arrays, "H W C"]
Batch = Float[Arrays, "N H W C"] | UInt8[Arrays, "N H W C"]


class Taps(NamedTuple):
    """Four neighbours per sample: flat indices y * W + x into the source, and their weights."""

    indices: Int[Array, "*s 4"]
    weights: Float[Array, "*s 4"]


def _taps_at(x: Float[Array, "*s"], y: Float[Array, "*s"], source_size: tuple[int, int]) -> Taps:
    height, width = source_size
    # Clipping one pixel beyond the fade keeps far and horizon points finite and gives them no gradient.
    x, y = jnp.clip(x, -2.0, width + 1.0), jnp.clip(y, -2.0, height + 1.0)
    x0, y0 = jnp.floor(jax.lax.stop_gradient(x)), jnp.floor(jax.lax.stop_gradient(y))
    fx, fy = x - x0, y - y0
    column, row = x0.astype(jnp.int32), y0.astype(jnp.int32)
    indices, weights = [], []
    for dy, wy in ((0, 1 - fy), (1, fy)):
        for dx, wx in ((0, 1 - fx), (1, fx)):
            inside = (column + dx >= 0) & (column + dx < width) & (row + dy >= 0) & (row + dy < height)
            flat = jnp.clip(row + dy, 0, height - 1) * width + jnp.clip(column + dx, 0, width - 1)
            indices.append(flat)
            weights.append(jnp.where(inside, wx * wy, jnp.zeros_like(wx)))
    return Taps(jnp.stack(indices, axis=-1), jnp.stack(weights, axis=-1))


def _gather(image: Shaped[Array, "H W C"], taps: Taps) -> Float[Array, "*s C"]:
    dtype = jnp.float32 if image.dtype == jnp.uint8 else image.dtype
    weights = taps.weights.astype(dtype)
    if image.dtype == jnp.uint8:
        weights = weights / 255
    flat = image.reshape(-1, image.shape[-1])
    total = jnp.zeros((), dtype)
    for k in range(4):
        value = flat.at[taps.indices[..., k]].get(mode="promise_in_bounds").astype(dtype)
        total = total + value * weights[..., k, None]
    return total


@partial(jax.jit, static_argnames="source_size")
def taps(points: Float[Arrays, "*s 2"], source_size: tuple[int, int]) -> Taps:
    """Taps of samples at points, to compute once where one warp serves a whole run; differentiable in the points.

    Args:
      points: (x, y) in the source, px; `grid_points` makes those of a homography.
      source_size: (H, W) of the source, px.
    """
    points = jnp.asarray(points)
    return _taps_at(points[..., 0], points[..., 1], source_size)


@partial(jax.jit, static_argnames="size")
def grid_points(source_from_target: Float[Arrays, "3 3"], size: tuple[int, int]) -> Float[Array, "h w 2"]:
    """Where a homography takes the pixels of a target of `size` (h, w); differentiable in it."""
    h = jnp.asarray(source_from_target)
    u, v = jnp.arange(size[1], dtype=h.dtype)[None, :], jnp.arange(size[0], dtype=h.dtype)[:, None]
    scale = jnp.abs(h[2, 0]) * u + jnp.abs(h[2, 1]) * v + jnp.abs(h[2, 2])
    w = safe_denominator(h[2, 0] * u + h[2, 1] * v + h[2, 2], scale)
    x = (h[0, 0] * u + h[0, 1] * v + h[0, 2]) / w
    y = (h[1, 0] * u + h[1, 1] * v + h[1, 2]) / w
    return jnp.stack([x, y], axis=-1)


@jax.jit
def gather(image: Pixels, taps: Taps) -> Float[Array, "h w C"]:
    """The weighted sum of four gathered pixels; differentiable in the image and in the weights."""
    return _gather(jnp.asarray(image), taps)


@jax.jit
def gather_batch(images: Batch, taps: Taps) -> Float[Array, "N h w C"]:
    """`gather` of many images of one size through the same taps."""
    return jax.vmap(_gather, in_axes=(0, None))(jnp.asarray(images), taps)


@jax.jit
def sample_bilinear(image: Pixels, points: Float[Arrays, "*s 2"]) -> Float[Array, "*s C"]:
    """Samples an image at points (x, y), px; differentiable in the image and in the points."""
    image, points = jnp.asarray(image), jnp.asarray(points)
    return _gather(image, taps(points, (image.shape[0], image.shape[1])))


@partial(jax.jit, static_argnames="size")
def warp(image: Pixels, source_from_target: Float[Arrays, "3 3"], size: tuple[int, int]) -> Float[Array, "h w C"]:
    """target(p) = image(H p), as for a floor view; differentiable in image and H.

    Args:
      image: the source.
      source_from_target: H, target pixel -> source pixel (`camera.image_from_view` for a floor view).
      size: (h, w) of the target, px.
    """
    return _gather(jnp.asarray(image), taps(grid_points(source_from_target, size), image.shape[:2]))


@partial(jax.jit, static_argnames="size")
def warp_batch(
    images: Batch, source_from_target: Float[Arrays, "3 3"], size: tuple[int, int]
) -> Float[Array, "N h w C"]:
    """`warp` of many images by one homography; the taps are computed once."""
    return gather_batch(images, taps(grid_points(source_from_target, size), images.shape[1:3]))


def rotate_pi(image: Shaped[Arrays, "*n H W C"]) -> Shaped[Array, "*n H W C"]:
    """Turns HWC or NHWC images by pi about their centre: R_pi, exact, no resampling."""
    return jnp.flip(jnp.asarray(image), axis=(-3, -2))


def flip_lr(image: Shaped[Arrays, "*n H W C"]) -> Shaped[Array, "*n H W C"]:
    """Mirrors HWC or NHWC images left to right."""
    return jnp.flip(jnp.asarray(image), axis=-2)
