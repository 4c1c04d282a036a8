"""Oak planks: growth rings cut lengthwise, knots that bend them, pores, planks of different shade and dark joints."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from ebjax.floors.noise import fractal_noise, gradient_noise, stretch
from ebjax.floors.surface import Family, Material, joint, lay, mix, spread

LENGTH = 7.5


def _knots(p: Float[Array, "*s 2"], key: Key[Array, ""]) -> tuple[Float[Array, "*s"], Float[Array, "*s"]]:
    """How far knots push the grain aside, and how dark they are; at most one in each 0.5 x 0.12 m of wood."""
    cell_m = (0.5, 0.12)
    cell = jnp.floor(stretch(jax.lax.stop_gradient(p), 1 / cell_m[0], 1 / cell_m[1]))
    at = cell.astype(jnp.int32)
    own = jax.random.uniform(key, (64 * 64, 4), p.dtype)[(at[..., 1] % 64) * 64 + at[..., 0] % 64]
    centre = stretch(cell + 0.3 + 0.4 * own[..., :2], *cell_m)
    offset = stretch(p - centre, 1 / 2.2, 1.0)
    radius = jnp.sqrt(jnp.sum(offset**2, axis=-1) + 1e-10)
    size = (0.004 + 0.011 * own[..., 2]) * (own[..., 3] < 0.14)
    push = 1.4 * size * jnp.exp(-radius / (2.2 * size + 1e-4))
    return push, jax.nn.sigmoid((size - radius) / 0.0015) * (size > 0)


def reflectance(points: Float[Array, "*s 2"], floor: Material, *, key: Key[Array, ""]) -> Float[Array, "*s 3"]:
    """Planks run along x with random end joints; `size_m` is their width, their length 7.5 times as much.

    Args:
      points: world, m.
      floor: sizes and disorder.
      key: of the designs and the layout.
    """
    layout, swing, ring_key, streak_key, pore_key, knot_key, broad_key = jax.random.split(key, 7)
    plank = lay(points, (LENGTH * floor.size_m, floor.size_m), floor, key=layout, bond=None, turns=2)
    p = plank.pattern
    push, knot = _knots(p, knot_key)
    # Cathedrals: rings are level lines of a surface that rises slowly along the plank.
    height = fractal_noise(stretch(p, 0.9, 5.5), key=swing, octaves=3) * 0.07 + p[..., 1] + push
    rings = height * 95.0
    ring = gradient_noise(jnp.stack([p[..., 0] * 0.8, rings], -1), key=ring_key)
    late = jnp.clip(ring * 2.2 + 0.05, 0, 1)
    streak = fractal_noise(stretch(p, 2.0, 120.0), key=streak_key, octaves=3)
    pore = jnp.clip(2.2 * gradient_noise(stretch(p, 28.0, 260.0), key=pore_key) - 0.45, 0, 1)
    broad = fractal_noise(stretch(p, 1.0, 6.0), key=broad_key, octaves=3)
    tone = 1 + 0.42 * floor.dirt * (plank.random[..., 0] - 0.5)
    value = tone * jnp.clip(1 + 0.13 * streak + 0.16 * broad, 0.5, 1.6)
    warm = spread((0.40, 0.272, 0.165), value)
    colour = mix(warm, spread((0.20, 0.115, 0.06), value), 0.62 * late)
    colour = mix(colour, (0.11, 0.065, 0.035), jnp.clip(0.5 * pore, 0, 1))
    colour = mix(colour, (0.075, 0.04, 0.022), 0.8 * knot)
    return mix(colour, (0.03, 0.02, 0.014), joint(plank.edge_m, floor.joint_m, floor.texel_m))


FAMILY = Family(
    reflectance,
    size_m=0.19,
    joint_m=0.0022,
    designs=12,
    gloss=0.07,
    marks={"stain": 0.25, "scratch": 0.45, "chip": 0.2, "repair": 0.01},
)
