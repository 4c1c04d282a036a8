"""Polished slabs of banded marble: grey bands and veins of several widths, each slab cut and turned at random."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from ebjax.floors.noise import fractal_noise, gradient_noise, stretch, warped
from ebjax.floors.surface import Family, Material, joint, lay, mix, spread


def reflectance(points: Float[Array, "*s 2"], floor: Material, *, key: Key[Array, ""]) -> Float[Array, "*s 3"]:
    """Bands and hairlines follow one direction of the stone and swing a little; where it is calm, veins cross it.

    Args:
      points: world, m.
      floor: sizes and disorder.
      key: of the designs and the layout.
    """
    layout, bend, bands, thin_key, cross_key, cloud_key, calm_key = jax.random.split(key, 7)
    slab = lay(points, (1.5 * floor.size_m, floor.size_m), floor, key=layout, bond=0.5, turns=2)
    p = slab.pattern
    # Each design was sawn out of the block at an angle of its own.
    angle = 9.7 * (p - slab.local)[..., 0]
    c, s = jnp.cos(angle), jnp.sin(angle)
    turned = jnp.stack([c * p[..., 0] + s * p[..., 1], c * p[..., 1] - s * p[..., 0]], axis=-1)
    bent = warped(1.6 * turned, 0.16, key=bend, octaves=4)
    across = stretch(bent, 0.5, 7.0)
    band = fractal_noise(across, key=bands, octaves=5)
    # How strongly a place is banded changes slowly along the block.
    calm = jnp.clip(0.45 + 1.7 * gradient_noise(0.4 * p, key=calm_key), 0, 1)
    streak = jax.nn.sigmoid((band - 0.08) / 0.07) * calm
    hair = jnp.exp(-jnp.abs(fractal_noise(1.7 * across, key=thin_key, octaves=2)) / 0.025) * calm
    crossing = jnp.exp(
        -jnp.abs(fractal_noise(1.3 * warped(2.0 * p, 0.6, key=cross_key), key=cross_key, octaves=3)) / 0.012
    )
    cloud = fractal_noise(6.0 * p, key=cloud_key, octaves=5)
    opacity = jnp.clip(0.62 * streak + 0.3 * hair + 0.4 * crossing * (1 - calm), 0, 0.85)
    tone = 1 + 0.2 * floor.dirt * (slab.random[..., 0] - 0.5) + 0.12 * cloud
    colour = mix(spread((0.50, 0.505, 0.48), tone), (0.145, 0.15, 0.15), opacity)
    return mix(colour, (0.10, 0.095, 0.085), joint(slab.edge_m, floor.joint_m, floor.texel_m))


FAMILY = Family(
    reflectance,
    size_m=0.55,
    joint_m=0.0025,
    designs=24,
    gloss=0.22,
    marks={"stain": 0.3, "crack": 0.18, "scratch": 0.22, "chip": 0.12, "gum": 0.14, "repair": 0.04},
)
