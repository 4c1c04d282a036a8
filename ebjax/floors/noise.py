"""Smooth random fields over the plane: gradient noise, its octaves, and domain warping. Pure functions of a key."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from ebjax.floors.lattice import entry

PERIOD = 64
Home = float | int | Float[Array, ""] | None


def stretch(points: Float[Array, "*s 2"], x: float, y: float) -> Float[Array, "*s 2"]:
    """(x, y) times two factors: noise of stretched points is long where the factor is small."""
    return jnp.stack([x * points[..., 0], y * points[..., 1]], axis=-1)


def gradient_noise(
    points: Float[Array, "*s 2"], *, key: Key[Array, ""], period: int = PERIOD, home: Home = None
) -> Float[Array, "*s"]:
    """Perlin noise: gradients at integer points blended by a quintic; zero mean, roughly within +-0.7.

    Args:
      points: (x, y) in lattice cells.
      key: of the gradients.
      period: side of the table of gradients, cells.
      home: where the noise repeats after a period, cells (`lattice.entry`): around the origin; None: everywhere.
    """
    angles = jax.random.uniform(key, (period, period), points.dtype, maxval=2 * jnp.pi)
    gradients = jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=-1).reshape(-1, 2)
    corner = jnp.floor(jax.lax.stop_gradient(points))
    local = points - corner
    cell = corner.astype(jnp.int32)
    fade = local**3 * (local * (6 * local - 15) + 10)
    total = jnp.zeros(points.shape[:-1], points.dtype)
    for dy in (0, 1):
        for dx in (0, 1):
            g = gradients[entry(cell[..., 0] + dx, cell[..., 1] + dy, (period, period), home)]
            dot = g[..., 0] * (local[..., 0] - dx) + g[..., 1] * (local[..., 1] - dy)
            wx = fade[..., 0] if dx else 1 - fade[..., 0]
            wy = fade[..., 1] if dy else 1 - fade[..., 1]
            total = total + wx * wy * dot
    return total


def fractal_noise(
    points: Float[Array, "*s 2"], *, key: Key[Array, ""], octaves: int = 4, home: Home = None
) -> Float[Array, "*s"]:
    """Sum of octaves, each twice as fine and half as strong; zero mean, roughly within +-1.

    Args:
      points: (x, y) in lattice cells of the first octave.
      key: of all octaves.
      octaves: how many.
      home: as that of `gradient_noise`, in cells of the first octave; one place for all octaves.
    """
    scales = 2.0 ** jnp.arange(octaves, dtype=points.dtype)

    def add(total, octave):
        scale, octave_key = octave
        own_home = None if home is None else home * scale
        return total + gradient_noise(points * scale, key=octave_key, home=own_home) / scale, None

    # A loop, not a sum of terms: unrolled, the fused gathers take XLA ten times longer to compile.
    return jax.lax.scan(add, jnp.zeros(points.shape[:-1], points.dtype), (scales, jax.random.split(key, octaves)))[0]


def warped(
    points: Float[Array, "*s 2"], strength: float, *, key: Key[Array, ""], octaves: int = 3, home: Home = None
) -> Float[Array, "*s 2"]:
    """Moves every point by fractal noise, p + strength * (noise, noise): straight structures become veins."""
    shift = jax.vmap(lambda k: fractal_noise(points, key=k, octaves=octaves, home=home), out_axes=-1)(
        jax.random.split(key)
    )
    return points + strength * shift
