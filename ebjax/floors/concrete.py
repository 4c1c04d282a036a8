"""Power-trowelled concrete: clouds, shade left by the trowel's sweep, pores, fine aggregate, sawn control joints."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from ebjax.floors.cells import voronoi
from ebjax.floors.noise import PERIOD, fractal_noise, gradient_noise, warped
from ebjax.floors.surface import Family, Material, joint, lay, mix, spread


def reflectance(points: Float[Array, "*s 2"], floor: Material, *, key: Key[Array, ""]) -> Float[Array, "*s 3"]:
    """Poured in one piece: nothing repeats but the joints, and contrast is low.

    Args:
      points: world, m.
      floor: sizes and disorder.
      key: of everything.
    """
    layout, cloud_key, patch_key, arc_key, grain_key, pore_key, swing_key = jax.random.split(key, 7)
    bent = warped(1.1 * points, 0.5, key=cloud_key, home=PERIOD)
    cloud = fractal_noise(bent, key=patch_key, octaves=5, home=PERIOD)
    # A trowel swung by hand: arcs about a centre that wanders, seen here and there.
    swing = jnp.stack([gradient_noise(0.45 * points, key=k, home=PERIOD) for k in jax.random.split(swing_key)], axis=-1)
    centre = points - 1.6 * jnp.round(points / 1.6) + 1.4 * swing
    radius = jnp.sqrt(jnp.sum(centre**2, axis=-1) + 1e-9)
    arc = jnp.stack([32.0 * radius, 3.0 * jnp.arctan2(centre[..., 1], centre[..., 0])], axis=-1)
    sweep = fractal_noise(arc, key=arc_key, octaves=3) * jnp.clip(0.4 + 2.0 * cloud, 0, 1)
    grain = fractal_noise(110.0 * points, key=grain_key, octaves=2, home=PERIOD)
    _, seed, own = voronoi(points / 0.03, key=pore_key)
    value = 1 + 0.30 * cloud + 0.09 * sweep + 0.10 * grain
    colour = mix(
        spread((0.335, 0.325, 0.305), value), spread((0.30, 0.27, 0.235), value), jnp.clip(1.5 * swing[..., 0], 0, 1)
    )
    pore = jax.nn.sigmoid((0.035 + 0.06 * own[..., 1] ** 3 - seed) / 0.02) * (own[..., 0] < 0.3)
    colour = mix(colour, (0.10, 0.095, 0.09), 0.7 * pore)
    panel = lay(points, (floor.size_m, floor.size_m), floor, key=layout)
    return mix(colour, (0.07, 0.068, 0.062), joint(panel.edge_m, floor.joint_m, floor.texel_m))


FAMILY = Family(
    reflectance,
    size_m=3.0,
    joint_m=0.005,
    designs=1,
    gloss=0.05,
    marks={"stain": 0.42, "crack": 0.14, "scratch": 0.16, "chip": 0.1, "gum": 0.06, "repair": 0.05},
)
