"""Polished porcelain stoneware: large near-white tiles with faint, drawn out veins and joints that hardly show."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from ebjax.floors.noise import fractal_noise, gradient_noise, stretch, warped
from ebjax.floors.surface import Family, Material, joint, lay, mix, spread


def reflectance(points: Float[Array, "*s 2"], floor: Material, *, key: Key[Array, ""]) -> Float[Array, "*s 3"]:
    """Veins are the zero lines of stretched noise; most of the tile is within a tenth of its mean.

    Args:
      points: world, m.
      floor: sizes and disorder.
      key: of the designs and the layout.
    """
    layout, bend, vein_key, thin_key, where_key, cloud_key = jax.random.split(key, 6)
    tile = lay(points, (floor.size_m, floor.size_m), floor, key=layout, turns=2)
    p = tile.pattern
    bent = stretch(warped(2.5 * p, 0.45, key=bend), 0.7, 2.0)
    where = jnp.clip(0.35 + 1.5 * gradient_noise(1.5 * p, key=where_key), 0, 1)
    vein = jnp.exp(-jnp.abs(fractal_noise(bent, key=vein_key, octaves=3)) / 0.05) * where
    thin = jnp.exp(-jnp.abs(fractal_noise(2.3 * bent, key=thin_key, octaves=2)) / 0.012) * where
    cloud = fractal_noise(2.0 * p, key=cloud_key)
    opacity = jnp.clip(0.2 * vein + 0.25 * thin + 0.06 * cloud, 0, 0.6)
    tone = 1 + 0.03 * floor.dirt * (tile.random[..., 0] - 0.5)
    colour = mix(spread((0.72, 0.71, 0.69), tone), (0.42, 0.40, 0.37), opacity)
    return mix(colour, (0.45, 0.44, 0.42), joint(tile.edge_m, floor.joint_m, floor.texel_m))


FAMILY = Family(
    reflectance,
    size_m=0.8,
    joint_m=0.002,
    designs=6,
    gloss=0.3,
    marks={"stain": 0.2, "crack": 0.05, "scratch": 0.3, "chip": 0.15, "gum": 0.1},
)
