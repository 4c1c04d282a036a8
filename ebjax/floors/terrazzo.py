"""Terrazzo poured between metal strips: stone chips of three sizes and several colours, ground flat, in cement."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from ebjax.floors.cells import voronoi
from ebjax.floors.noise import PERIOD, fractal_noise
from ebjax.floors.surface import Family, Material, joint, lay, mix, spread

CEMENT = (0.33, 0.32, 0.295)
CHIPS = ((0.62, 0.60, 0.55), (0.40, 0.385, 0.35), (0.09, 0.09, 0.09), (0.30, 0.19, 0.13), (0.22, 0.235, 0.22))
# Chips across in m, share of the places that hold one, width of the cement around it in cells.
SIZES = ((0.007, 0.55, 0.10), (0.016, 0.45, 0.09), (0.034, 0.16, 0.08))


def reflectance(points: Float[Array, "*s 2"], floor: Material, *, key: Key[Array, ""]) -> Float[Array, "*s 3"]:
    """Chips are shrunk Voronoi cells, larger ones over smaller; nothing repeats but the metal strips.

    Args:
      points: world, m.
      floor: sizes and disorder.
      key: of the chips.
    """
    layout, cloud_key, mottle, *chip_keys = jax.random.split(key, 3 + len(SIZES))
    cloud = fractal_noise(1.2 * points, key=cloud_key, home=PERIOD)
    colour = spread(CEMENT, 1 + 0.12 * cloud)
    grain = fractal_noise(90.0 * points, key=mottle, octaves=2, home=PERIOD)
    palette = jnp.asarray(CHIPS, points.dtype)
    for (size_m, share, gap), chip_key in zip(SIZES, chip_keys, strict=True):
        edge, _, own = voronoi(points / size_m, key=chip_key)
        kind = jnp.minimum((own[..., 0] ** 1.3 * len(CHIPS)).astype(jnp.int32), len(CHIPS) - 1)
        stone = palette[kind] * (0.75 + 0.5 * own[..., 1] + 0.12 * grain)[..., None]
        soft = 0.6 * floor.texel_m / size_m
        inside = jax.nn.sigmoid((edge - gap - 0.12 * own[..., 3]) / (0.4 * soft))
        colour = mix(colour, stone, inside * (own[..., 2] < share))
    panel = lay(points, (floor.size_m, floor.size_m), floor, key=layout)
    return mix(colour, (0.24, 0.19, 0.11), joint(panel.edge_m, floor.joint_m, floor.texel_m))


FAMILY = Family(
    reflectance,
    size_m=1.2,
    joint_m=0.004,
    designs=1,
    gloss=0.15,
    marks={"stain": 0.35, "crack": 0.12, "scratch": 0.2, "chip": 0.08, "gum": 0.1, "repair": 0.03},
)
