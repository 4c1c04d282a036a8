"""Slabs of natural stone (slate, travertine): cleft and mottled, different in shade, in broken bond."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from ebjax.floors.lattice import HOME_M
from ebjax.floors.noise import fractal_noise, gradient_noise, warped
from ebjax.floors.surface import Family, Material, joint, lay, mix, spread


def reflectance(points: Float[Array, "*s 2"], floor: Material, *, key: Key[Array, ""]) -> Float[Array, "*s 3"]:
    """Mottling at three scales, cleavage ridges, pale scuffed edges.

    Args:
      points: world, m.
      floor: sizes and disorder.
      key: of the designs and the layout.
    """
    layout, bend, broad_key, fine_key, ridge_key, rust_key, wobble = jax.random.split(key, 7)
    # Sawn by hand: edges wander by a millimetre or two.
    shaken = points + 0.0025 * jnp.stack(
        [gradient_noise(9.0 * points, key=k, home=9.0 * HOME_M) for k in jax.random.split(wobble)], axis=-1
    )
    slab = lay(shaken, (1.5 * floor.size_m, floor.size_m), floor, key=layout, bond=0.37, turns=2)
    p = slab.pattern
    bent = warped(3.0 * p, 0.7, key=bend)
    broad = fractal_noise(bent, key=broad_key, octaves=4)
    fine = fractal_noise(28.0 * p, key=fine_key, octaves=4)
    ridge = jnp.exp(-jnp.abs(fractal_noise(1.6 * bent, key=ridge_key, octaves=4)) / 0.02)
    rust = jnp.clip(1.8 * gradient_noise(1.1 * p, key=rust_key) - 0.25, 0, 1)
    tone = jnp.where(jnp.asarray(floor.dirt) > 0, 0.72 + 0.56 * slab.random[..., 0], 1)
    value = jnp.clip(tone * (1 + 0.42 * broad + 0.22 * fine + 0.16 * ridge), 0.3, 2.2)
    colour = mix(spread((0.235, 0.23, 0.215), value), spread((0.27, 0.19, 0.12), value), 0.6 * rust)
    worn = 0.25 * jnp.exp(-slab.edge_m / 0.008)
    colour = mix(colour, (0.42, 0.40, 0.37), worn)
    mortar = spread((0.16, 0.15, 0.135), 1 + 0.35 * fine)
    return mix(colour, mortar, joint(slab.edge_m, floor.joint_m, floor.texel_m))


FAMILY = Family(
    reflectance,
    size_m=0.4,
    joint_m=0.008,
    designs=16,
    gloss=0.04,
    marks={"stain": 0.32, "crack": 0.2, "scratch": 0.12, "chip": 0.24, "gum": 0.08, "repair": 0.04},
)
