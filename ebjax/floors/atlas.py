"""The floor of a whole plan as one texture: a strip a corridor, side by side, each with some floor beyond its ends.

Kept in float16: 100 m of corridor at 3 mm take a fifth of a gigabyte.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from ebjax.floors import mipmap
from ebjax.floors.mipmap import Mipmap
from ebjax.floors.plan import Plan

LEVELS = 8


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Atlas:
    """The texture, and which rectangle of the world each strip of it covers."""

    texture: Mipmap
    origins: Float[Array, "S 2"]
    """World x and y of the corner of each strip's rectangle, m."""
    directions: Float[Array, "S 2"]
    """Unit vector along it; its width lies to the left."""
    lengths: Float[Array, " S"]
    width_m: Float[Array, ""]
    columns: Float[Array, " S"]
    """Column of the texture at which the rectangle begins, px."""
    texel_m: float = dataclasses.field(metadata=dict(static=True))


class Ground(NamedTuple):
    """Where world points lie on the floor."""

    texel: Float[Array, "*s 2"]
    """(column, row) of the texture."""
    direction: Float[Array, "*s 2"]
    """Of their strip."""
    along: Float[Array, "*s"]
    """From its beginning, m."""
    across: Float[Array, "*s"]
    """To the left of its middle, m."""
    clearance: Float[Array, "*s"]
    """To the nearest side of any strip that holds the point, m; below 0 outside."""


def locate(atlas: Atlas, x: Float[Array, "*s"], y: Float[Array, "*s"]) -> Ground:
    """Finds the first strip that holds each point; points outside all are as if on the first."""
    strips = atlas.origins, atlas.directions, atlas.lengths, atlas.columns

    def inside(origin, direction, length):
        dx, dy = x - origin[..., 0], y - origin[..., 1]
        u = dx * direction[..., 0] + dy * direction[..., 1]
        v = dy * direction[..., 0] - dx * direction[..., 1]
        return u, v, jnp.minimum(jnp.minimum(u, length - u), jnp.minimum(v, atlas.width_m - v))

    def step(seen, number):
        strip, clearance = seen
        inner = inside(*(column[number] for column in strips[:3]))[2]
        return (jnp.where((clearance < 0) & (inner >= 0), number, strip), jnp.maximum(clearance, inner)), None

    start = jnp.zeros(x.shape, jnp.int32), inside(*(column[0] for column in strips[:3]))[2]
    (strip, clearance), _ = jax.lax.scan(step, start, jnp.arange(1, len(atlas.lengths), dtype=jnp.int32))
    # What many readers fuse with, XLA computes again for each of them.
    strip, clearance = jax.lax.optimization_barrier((strip, clearance))
    direction = atlas.directions[strip]
    u, v, _ = inside(atlas.origins[strip], direction, 0.0)
    texel = jnp.stack([u / atlas.texel_m + atlas.columns[strip] - 0.5, v / atlas.texel_m - 0.5], axis=-1)
    return Ground(texel, direction, u, v - atlas.width_m / 2, clearance)


def look(atlas: Atlas, ground: Ground, by_pixel: Float[Array, "*s 2 2"]) -> Float[Array, "*s C"]:
    """Reflectance of the floor, filtered over a pixel; `by_pixel` has the rows d(x, y)/d(pixel u), d(x, y)/d(v)."""
    c, s = ground.direction[..., None, 0], ground.direction[..., None, 1]
    axes = jnp.stack(
        [by_pixel[..., 0] * c + by_pixel[..., 1] * s, by_pixel[..., 1] * c - by_pixel[..., 0] * s], axis=-1
    )
    return mipmap.sample_anisotropic(atlas.texture, ground.texel, axes / atlas.texel_m)


def make_atlas(
    image: Float[np.ndarray, "H W C"], columns: list[int], plan: Plan, texel_m: float, dtype: DTypeLike = jnp.float32
) -> Atlas:
    """An atlas of one image in which a plan's strips lie side by side.

    Args:
      image: row 0 is the right side of each strip, seen along it.
      columns: at which each rectangle begins.
      plan: whose rectangles the strips cover.
      texel_m: side of a texel.
      dtype: of directions and lengths, not of the texels.
    """
    origins, directions, lengths, width_m, starts = (
        jnp.asarray(np.asarray(n, dtype)) for n in (plan.origins, plan.directions, plan.lengths, plan.width_m, columns)
    )
    return Atlas(mipmap.build(image, LEVELS), origins, directions, lengths, width_m, starts, texel_m)
