"""Loop-pile carpet tiles: rows of tufts of one yarn, laid with the pile turned; nothing cracks, chips or scratches.

Tufts are 4 by 5 mm, near what a camera at half a metre resolves: their contrast is gone a metre further away, and what
is left is a regular weave, the tiles' edges, and soft shade where feet have pressed the pile.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from ebjax.floors.noise import fractal_noise, gradient_noise
from ebjax.floors.surface import Family, Material, joint, lay, mix, spread

TUFT_M = (0.0105, 0.008)


def reflectance(points: Float[Array, "*s 2"], floor: Material, *, key: Key[Array, ""]) -> Float[Array, "*s 3"]:
    """A product of waves along and across the rows, a little of each tuft's own shade, turned tile by tile.

    Args:
      points: world, m.
      floor: sizes and disorder.
      key: of the yarn and the layout.
    """
    layout, tuft_key, tread_key, line_key = jax.random.split(key, 4)
    tile = lay(points, (floor.size_m, floor.size_m), floor, key=layout)
    p = tile.pattern
    x, y = p[..., 0] / TUFT_M[0], p[..., 1] / TUFT_M[1]
    row = jnp.floor(jax.lax.stop_gradient(y))
    x = x + 0.5 * (row % 2)
    loop = (0.5 + 0.5 * jnp.cos(2 * jnp.pi * x)) * (0.5 + 0.5 * jnp.cos(2 * jnp.pi * (y - row - 0.5)))
    cell = jnp.stack([jnp.floor(jax.lax.stop_gradient(x)), row], -1).astype(jnp.int32) % 128
    yarn = jax.random.normal(tuft_key, (128 * 128,), points.dtype)[cell[..., 1] * 128 + cell[..., 0]]
    line = gradient_noise(jnp.stack([p[..., 0] * 1.5, p[..., 1] * 70.0], -1), key=line_key)
    tread = fractal_noise(0.8 * points, key=tread_key, octaves=3)
    # Pile turned by a quarter throws its shade the other way: tiles differ although their yarn does not.
    nap = 0.05 * jnp.where(tile.random[..., 1] < 0.5, -1.0, 1.0).astype(points.dtype) * floor.dirt
    value = (0.72 + 0.5 * loop) * (1 + 0.10 * yarn + 0.16 * line) * (1 + nap + 0.08 * floor.dirt * tread)
    colour = spread((0.088, 0.094, 0.112), value)
    return mix(colour, (0.03, 0.03, 0.035), 0.7 * joint(tile.edge_m, floor.joint_m, floor.texel_m))


FAMILY = Family(
    reflectance,
    size_m=0.5,
    joint_m=0.0015,
    designs=1,
    gloss=0.0,
    marks={"stain": 0.12, "gum": 0.02},
)
