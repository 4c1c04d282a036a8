"""A texture with its mip levels in one flat array, looked up trilinearly by footprint: far floor does not alias.

Level l has half the side of level l - 1. Those of level 0 are multiples of 2^(levels - 1), so that sizes and offsets
are shifts instead of tables and one gather serves all levels. Texel centres at integers; edges are clamped.
"""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Mipmap:
    """All levels, finest first, each row-major; the size is that of level 0, px."""

    texels: Float[Array, "P C"]
    height: int = dataclasses.field(metadata=dict(static=True))
    width: int = dataclasses.field(metadata=dict(static=True))
    levels: int = dataclasses.field(metadata=dict(static=True))


@partial(jax.jit, static_argnames="levels")
def build(image: Float[Array, "H W C"], levels: int = 8) -> Mipmap:
    """Pads the image by its edge to multiples of 2^(levels - 1) and averages 2x2 texels per level."""
    block = 2 ** (levels - 1)
    height, width, channels = image.shape
    image = jnp.pad(image, ((0, -height % block), (0, -width % block), (0, 0)), mode="edge")
    height, width, _ = image.shape
    pyramid, exact = [image], jnp.promote_types(image.dtype, jnp.float32)
    for _ in range(levels - 1):
        # Sums of slices, not a mean over reshaped axes: nothing of the image's size is held in float32.
        fine = pyramid[-1]
        parts = [fine[i::2, j::2].astype(exact) / 4 for i in (0, 1) for j in (0, 1)]
        pyramid.append(sum(parts[1:], parts[0]).astype(image.dtype))
    return Mipmap(jnp.concatenate([p.reshape(-1, channels) for p in pyramid]), height, width, levels)


def _bilinear(mip: Mipmap, points: Float[Array, "*s 2"], level: Int[Array, "*s"]) -> Float[Array, "*s C"]:
    height, width = mip.height >> level, mip.width >> level
    start = (4 * mip.height * mip.width - ((4 * mip.height * mip.width) >> (2 * level))) // 3
    scale = 0.5 ** level.astype(points.dtype)
    x = jnp.clip((points[..., 0] + 0.5) * scale - 0.5, 0, (width - 1).astype(points.dtype))
    y = jnp.clip((points[..., 1] + 0.5) * scale - 0.5, 0, (height - 1).astype(points.dtype))
    x0, y0 = jnp.floor(jax.lax.stop_gradient(x)), jnp.floor(jax.lax.stop_gradient(y))
    fx, fy = (x - x0)[..., None], (y - y0)[..., None]
    column, row = x0.astype(jnp.int32), y0.astype(jnp.int32)
    right = jnp.minimum(column + 1, width - 1)
    top, bottom = start + row * width, start + jnp.minimum(row + 1, height - 1) * width

    def texel(index: Int[Array, "*s"]) -> Float[Array, "*s C"]:
        return mip.texels.at[index].get(mode="promise_in_bounds").astype(points.dtype)

    upper = texel(top + column) * (1 - fx) + texel(top + right) * fx
    lower = texel(bottom + column) * (1 - fx) + texel(bottom + right) * fx
    return upper * (1 - fy) + lower * fy


def sample(mip: Mipmap, points: Float[Array, "*s 2"], footprint_px: Float[Array, "*s"]) -> Float[Array, "*s C"]:
    """Trilinear lookup at level log2(footprint); differentiable in texels, points and (between levels) footprint.

    Args:
      mip: the texture.
      points: (x, y) in texels of level 0.
      footprint_px: side of the square that the sample stands for, texels of level 0; below 1 magnifies.
    """
    exact = jnp.clip(jnp.log2(jnp.maximum(footprint_px, 1.0)), 0.0, mip.levels - 1.0)
    level = jnp.minimum(jnp.floor(jax.lax.stop_gradient(exact)).astype(jnp.int32), mip.levels - 2)
    blend = (exact - level.astype(exact.dtype))[..., None]
    return _bilinear(mip, points, level) * (1 - blend) + _bilinear(mip, points, level + 1) * blend


def sample_anisotropic(
    mip: Mipmap, points: Float[Array, "*s 2"], axes_px: Float[Array, "*s 2 2"], taps: int = 2
) -> Float[Array, "*s C"]:
    """Averages trilinear lookups along the pixel's longer side on the texture: oblique floor stays sharp across.

    Args:
      mip: the texture.
      points: (x, y) in texels of level 0.
      axes_px: rows d(point)/d(pixel x) and d(point)/d(pixel y), texels.
      taps: lookups per sample; the footprint is the longer side / taps, or the shorter side where that is longer.
    """
    length = jnp.sqrt(jnp.sum(axes_px**2, axis=-1) + 1e-12)
    long = jnp.where((length[..., 0] > length[..., 1])[..., None], axes_px[..., 0, :], axes_px[..., 1, :])
    longer = jnp.max(length, axis=-1)
    area = jnp.abs(axes_px[..., 0, 0] * axes_px[..., 1, 1] - axes_px[..., 0, 1] * axes_px[..., 1, 0])
    footprint = jnp.maximum(area / longer, longer / taps)
    offsets = [(i + 0.5) / taps - 0.5 for i in range(taps)]
    return (
        sum(
            (sample(mip, points + o * long, footprint) for o in offsets[1:]),
            sample(mip, points + offsets[0] * long, footprint),
        )
        / taps
    )
