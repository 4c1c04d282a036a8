"""Loop-pile carpet tiles: rows of tufts of one yarn, their pile turned tile by tile; nothing cracks or chips.

What one sees of a carpet is mostly its relief and the way its pile leans: bright where it leans away, dark where it
leans towards the eye. From the other side bright and dark change places, so that views from opposite sides hardly
agree; what stays is the regular weave, the seams, and the few stains.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from ebjax.floors.lattice import HOME_M
from ebjax.floors.noise import fractal_noise
from ebjax.floors.surface import Family, Material, joint, lay, mix, spread

TUFT_M = (0.0105, 0.008)


def reflectance(points: Float[Array, "*s 2"], floor: Material, *, key: Key[Array, ""]) -> Float[Array, "*s 5"]:
    """Colour, and the lean of the pile: the renderer multiplies the colour by 1 + lean . view direction.

    Args:
      points: world, m.
      floor: sizes and disorder.
      key: of the yarn and the layout.
    """
    layout, tuft_key, tread_key = jax.random.split(key, 3)
    tile = lay(points, (floor.size_m, floor.size_m), floor, key=layout)
    p = tile.pattern
    x, y = p[..., 0] / TUFT_M[0], p[..., 1] / TUFT_M[1]
    row = jnp.floor(jax.lax.stop_gradient(y))
    x = x + 0.5 * (row % 2)
    column = jnp.floor(jax.lax.stop_gradient(x))
    u, v = 2 * jnp.pi * x, 2 * jnp.pi * (y - row - 0.5)
    loop = (0.5 + 0.5 * jnp.cos(u)) * (0.5 + 0.5 * jnp.cos(v))
    cell = ((row % 128) * 128 + column % 128).astype(jnp.int32)
    own = jax.random.normal(tuft_key, (128 * 128, 3), points.dtype)[cell]
    colour = spread((0.088, 0.094, 0.112), (0.75 + 0.5 * loop) * (1 + 0.08 * own[..., 0]))
    seam = joint(tile.edge_m, floor.joint_m, floor.texel_m)
    colour = mix(colour, (0.03, 0.03, 0.035), 0.6 * seam)
    tread = jnp.stack(
        [fractal_noise(1.2 * points, key=k, home=1.2 * HOME_M) for k in jax.random.split(tread_key)], axis=-1
    )
    turn = 0.5 * jnp.pi * jnp.floor(4 * tile.random[..., 1])
    laid = jnp.stack([jnp.cos(turn), jnp.sin(turn)], axis=-1)
    bulge = jnp.stack([-jnp.sin(u), -jnp.sin(v)], axis=-1)
    lean = 0.12 * floor.dirt * laid + 0.2 * floor.dirt * tread + 0.2 * own[..., 1:] + 0.15 * bulge
    return jnp.concatenate([colour, lean], axis=-1)


FAMILY = Family(
    reflectance,
    size_m=0.5,
    joint_m=0.0015,
    designs=1,
    gloss=0.0,
    marks={"stain": 0.12, "gum": 0.02},
)
