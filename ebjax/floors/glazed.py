"""Glazed ceramic tiles with a printed marble: soft blotches and faint veins in warm grey on off-white, dark grout."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from ebjax.floors.lattice import HOME_M
from ebjax.floors.noise import fractal_noise, gradient_noise, warped
from ebjax.floors.surface import Family, Material, joint, lay, mix, spread


def reflectance(points: Float[Array, "*s 2"], floor: Material, *, key: Key[Array, ""]) -> Float[Array, "*s 3"]:
    """Veins are the zero lines of domain-warped noise; few designs, so tiles repeat exactly under their dirt.

    Args:
      points: world, m.
      floor: sizes and disorder.
      key: of the designs and the layout.
    """
    layout, bend, cloud_key, veins, grime = jax.random.split(key, 5)
    tile = lay(points, (floor.size_m, floor.size_m), floor, key=layout)
    p = tile.pattern
    bent = warped(5.0 * p, 0.8, key=bend)
    cloud = fractal_noise(3.0 * p, key=cloud_key)
    broad, thin, where = (
        gradient_noise(q, key=k) for q, k in zip((0.5 * bent, bent, 2.2 * p), jax.random.split(veins, 3), strict=True)
    )
    strength = jnp.clip(0.45 + 1.6 * where, 0, 1)
    blotch = jnp.exp(-jnp.abs(broad) / 0.08) * strength
    vein = jnp.exp(-jnp.abs(thin) / 0.018) * strength
    opacity = jnp.clip(0.45 * blotch + 0.45 * vein + 0.18 * cloud, 0, 0.85)
    tone = 1 + 0.05 * floor.dirt * (tile.random[..., 0] - 0.5)
    colour = mix(spread((0.62, 0.61, 0.57), tone), (0.30, 0.265, 0.23), opacity)
    filth = fractal_noise(2.5 * points, key=grime, home=2.5 * HOME_M)
    grout = spread((0.105, 0.098, 0.09), 1 + 0.6 * floor.dirt * filth)
    return mix(colour, grout, joint(tile.edge_m, floor.joint_m, floor.texel_m))


FAMILY = Family(
    reflectance,
    size_m=0.6,
    joint_m=0.006,
    designs=4,
    gloss=0.15,
    marks={"stain": 0.33, "crack": 0.13, "scratch": 0.2, "chip": 0.28, "gum": 0.04, "repair": 0.02},
)
