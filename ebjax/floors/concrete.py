"""Power-trowelled concrete: clouds, shade left by the trowel's sweep, pores, fine aggregate, sawn control joints."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from ebjax.floors.cells import voronoi
from ebjax.floors.noise import fractal_noise, gradient_noise, warped
from ebjax.floors.surface import Family, Material, joint, lay, mix, spread


def reflectance(points: Float[Array, "*s 2"], floor: Material, *, key: Key[Array, ""]) -> Float[Array, "*s 3"]:
    """Poured in one piece: nothing repeats but the joints, and contrast is low.

    Args:
      points: world, m.
      floor: sizes and disorder.
      key: of everything.
    """
    layout, cloud_key, patch_key, arc_key, grain_key, pore_key, hair_key = jax.random.split(key, 7)
    bent = warped(1.1 * points, 0.5, key=cloud_key)
    cloud = fractal_noise(bent, key=patch_key, octaves=5)
    # The machine walks along x and its blades sweep circles of half a metre.
    phase = gradient_noise(0.8 * points, key=hair_key)
    centre = jnp.stack([points[..., 0] - 0.55 * jnp.round(points[..., 0] / 0.55), points[..., 1] + 0.3 * phase], -1)
    radius = jnp.sqrt(jnp.sum(centre**2, axis=-1) + 1e-9)
    sweep = fractal_noise(jnp.stack([26.0 * radius, 1.5 * points[..., 0]], -1), key=arc_key, octaves=3)
    grain = fractal_noise(120.0 * points, key=grain_key, octaves=2)
    edge, own = voronoi(points / 0.028, key=pore_key)
    value = 1 + 0.26 * cloud + 0.10 * sweep + 0.06 * grain
    colour = spread((0.335, 0.325, 0.305), value)
    size = 0.12 + 0.1 * own[..., 1]
    pore = jax.nn.sigmoid((edge - (0.5 - size)) / 0.03) * (own[..., 0] < 0.16)
    colour = mix(colour, (0.09, 0.085, 0.08), 0.75 * pore)
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
