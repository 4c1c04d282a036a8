"""A floor of glazed marble tiles, rasterised once: few distinct tiles that repeat, grout between them, wear on top.

Everything is linear reflectance in [0, 1]. The strip covers x in [0, length], y in [0, width] of its own frame, metres:
texel (column, row) has its centre at x = (column + 0.5) texel_m, y = (row + 0.5) texel_m.
"""

import dataclasses
import math
from functools import partial

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Key

from ebjax.floors import wear
from ebjax.floors.noise import fractal_noise, gradient_noise, warped


@dataclasses.dataclass(frozen=True)
class TileConfig:
    """A tiled floor. Fewer distinct tiles and less disorder mean more aliasing; more wear makes places unique."""

    tile_m: float = 0.6
    """Side of a tile, m."""
    grout_m: float = 0.006
    """Width of the grout lines, m."""
    distinct_tiles: int = 4
    """Tile designs; they repeat in a lattice."""
    disorder: float = 0.3
    """Share of tiles laid out of the lattice: any design, any of four orientations."""
    dirt: float = 1.0
    """Strength of grime and of the tiles' differences in shade; 0 makes equal tiles equal."""
    wear_per_m2: float = 4.0
    """Stains, cracks, scratches and chips per square metre."""
    texel_m: float = 0.003
    """Side of a texel, m."""


def check(config: TileConfig) -> None:
    """Raises ValueError that names the key which no floor can have."""
    for name in ("tile_m", "distinct_tiles", "texel_m"):
        if not getattr(config, name) > 0:
            raise ValueError(f"floor.{name} is {getattr(config, name)}: needs a value above 0")
    if not 0 <= config.grout_m < config.tile_m:
        raise ValueError(
            f"floor.grout_m is {config.grout_m}: needs a value from 0 to below floor.tile_m ({config.tile_m})"
        )
    if not 0 <= config.disorder <= 1:
        raise ValueError(f"floor.disorder is {config.disorder}: needs a value from 0 to 1")
    for name in ("dirt", "wear_per_m2"):
        if not getattr(config, name) >= 0:
            raise ValueError(f"floor.{name} is {getattr(config, name)}: needs a value of 0 or more")


def marble_tile(
    size: int, tile_m: float, *, key: Key[Array, ""], dtype: DTypeLike = jnp.float32
) -> Float[Array, "n n 3"]:
    """One tile: clouds and veins, the zero lines of domain-warped noise, in warm grey on off-white."""
    hue, bend, clouds, veins = jax.random.split(key, 4)
    axis = (jnp.arange(size, dtype=dtype) + 0.5) / size * (tile_m / 0.6)
    points = jnp.stack(jnp.meshgrid(axis, axis), axis=-1)
    bent = warped(4.0 * points, 0.7, key=bend)
    cloud = fractal_noise(3.0 * points, key=clouds)
    fields = jnp.stack([0.6 * bent, bent, 1.5 * points])
    broad, thin, thick = jax.vmap(lambda p, k: gradient_noise(p, key=k))(fields, jax.random.split(veins, 3))
    soft, fine = jnp.exp(-jnp.abs(broad) / 0.09), jnp.exp(-jnp.abs(thin) / 0.015)
    strength = 0.5 + 0.5 * jnp.clip(2.5 * thick, -1, 1)
    base = jnp.array([0.66, 0.65, 0.60], dtype) + 0.03 * jax.random.normal(hue, (1,), dtype)
    vein = jnp.array([0.30, 0.28, 0.25], dtype)
    opacity = jnp.clip(0.5 * soft * strength + 0.7 * fine * strength + 0.3 * cloud, 0, 0.9)[..., None]
    return base[None, None, :] * (1 - opacity) + vein[None, None, :] * opacity


@partial(jax.jit, static_argnames=("length_m", "width_m", "config", "dtype"))
def tile_floor(
    length_m: float, width_m: float, config: TileConfig, *, key: Key[Array, ""], dtype: DTypeLike = jnp.float32
) -> Float[Array, "H W 3"]:
    """The strip of floor, rows along y, columns along x; a pure function of the key.

    Args:
      length_m: along x.
      width_m: along y.
      config: the tiles and their wear.
      key: of everything random.
      dtype: of the strip.
    """
    design, layout, dirt, marks = jax.random.split(key, 4)
    texel, tile = config.texel_m, config.tile_m
    height, width = math.ceil(width_m / texel), math.ceil(length_m / texel)
    size = math.ceil(tile / texel)
    tiles = jax.vmap(lambda k: marble_tile(size, tile, key=k, dtype=dtype))(
        jax.random.split(design, config.distinct_tiles)
    )
    bank = jnp.stack([jnp.rot90(tiles, k, axes=(1, 2)) for k in range(4)], axis=1).reshape(-1, size, size, 3)

    # Half a tile of offset puts no grout line under the middle of the corridor's wall.
    x, y = (
        (jnp.arange(width, dtype=dtype) + 0.5) * texel / tile,
        (jnp.arange(height, dtype=dtype) + 0.5) * texel / tile + 0.5,
    )
    rows, columns = math.ceil(width_m / tile) + 1, math.ceil(length_m / tile) + 1
    i, j = jnp.arange(columns), jnp.arange(rows)
    which, moved, tone = jax.random.split(layout, 3)
    lattice = 4 * ((i[None, :] + 2 * j[:, None]) % config.distinct_tiles)
    stray = jax.random.randint(which, (rows, columns), 0, 4 * config.distinct_tiles)
    index = jnp.where(jax.random.uniform(moved, (rows, columns)) < config.disorder, stray, lattice)
    gain = 1 + 0.04 * config.dirt * jax.random.normal(tone, (rows, columns), dtype)

    column, row = jnp.floor(x).astype(jnp.int32), jnp.floor(y).astype(jnp.int32)
    u, v = ((x - column) * size).astype(jnp.int32), ((y - row) * size).astype(jnp.int32)
    cell = (row[:, None], column[None, :])
    floor = bank[index[cell], v[:, None], u[None, :]] * gain[cell][..., None]

    def line(t: Float[Array, " n"]) -> Float[Array, " n"]:
        from_edge = tile * jnp.minimum(t - jnp.floor(t), jnp.ceil(t) - t)
        return jnp.clip((config.grout_m / 2 - from_edge) / texel + 0.5, 0, 1)

    grout = jnp.maximum(line(y)[:, None], line(x)[None, :])[..., None]
    grime = jax.random.split(dirt)
    coarse = jnp.stack(jnp.meshgrid(jnp.arange(0, length_m, 0.02, dtype), jnp.arange(0, width_m, 0.02, dtype)), axis=-1)
    patches = jnp.stack([fractal_noise(coarse * f, key=k) for f, k in zip((1.5, 4.0), grime, strict=True)], axis=-1)
    patches = config.dirt * jax.image.resize(patches, (height, width, 2), "linear")
    colour = 0.09 + 0.04 * patches[..., 1:]
    floor = floor * (1 - grout) + jnp.maximum(colour, 0.03) * grout * jnp.array([1.0, 0.97, 0.92], dtype)[None, None, :]
    floor = floor * (1 + 0.12 * patches[..., :1])
    return jnp.clip(wear.paint(floor, config.wear_per_m2, texel, key=marks), 0.01, 0.95)
