"""Photographs laid as tiles: real appearance in a synthetic place. Few photographs mean few designs."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from ebjax.floors.surface import Family, Material, joint, lay, mix


def reflectance(
    points: Float[Array, "*s 2"], floor: Material, photographs: Float[Array, "N n n 3"], *, key: Key[Array, ""]
) -> Float[Array, "*s 3"]:
    """Each design is a square cut from one photograph, bilinear between its pixels.

    Args:
      points: world, m.
      floor: sizes and disorder.
      photographs: square cuts, linear reflectance, one a design.
      key: of the layout.
    """
    count, side = photographs.shape[:2]
    tile = lay(points, (floor.size_m, floor.size_m), floor, key=key)
    which = tile.design % count
    at = (tile.local / floor.size_m + 0.5) * side - 0.5
    at = jnp.clip(at, 0, side - 1.001)
    low = jnp.floor(jax.lax.stop_gradient(at))
    f = at - low
    column, row = low[..., 0].astype(jnp.int32), low[..., 1].astype(jnp.int32)
    upper = photographs[which, row, column] * (1 - f[..., :1]) + photographs[which, row, column + 1] * f[..., :1]
    lower = (
        photographs[which, row + 1, column] * (1 - f[..., :1]) + photographs[which, row + 1, column + 1] * f[..., :1]
    )
    colour = upper * (1 - f[..., 1:]) + lower * f[..., 1:]
    tone = 1 + 0.05 * floor.dirt * (tile.random[..., 0] - 0.5)
    return mix(colour * tone[..., None], (0.1, 0.095, 0.09), joint(tile.edge_m, floor.joint_m, floor.texel_m))


FAMILY = Family(
    reflectance,
    size_m=0.6,
    joint_m=0.005,
    designs=4,
    gloss=0.08,
    marks={"stain": 0.35, "crack": 0.15, "scratch": 0.2, "chip": 0.28, "repair": 0.02},
)
