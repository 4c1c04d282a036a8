"""The floor of a whole plan as one texture: a strip a corridor, side by side, each with some floor beyond its ends.

Strips sample one endless floor in world coordinates: where corridors meet, tiles and marks go on. Made block by block
(one program for all) and kept in float16: 100 m of corridor at 3 mm take a fifth of a gigabyte.
"""

import dataclasses
import math
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int, Key

from ebjax.floors import mipmap, wear
from ebjax.floors.lattice import HOME_M
from ebjax.floors.mipmap import Mipmap
from ebjax.floors.noise import fractal_noise
from ebjax.floors.plan import Plan
from ebjax.floors.surface import FloorConfig, Material, family, material

LEVELS = 8
BLOCK = 1024
GUTTER = 64


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Atlas:
    """The texture, and which rectangle of the world each strip of it covers."""

    texture: Mipmap
    origins: Float[Array, "S 2"]
    """World x and y of the corner of each strip's rectangle, m."""
    directions: Float[Array, "S 2"]
    """Unit vector along it; its width lies to the left."""
    lengths: Float[Array, " S"]
    width_m: Float[Array, ""]
    columns: Float[Array, " S"]
    """Column of the texture at which the rectangle begins, px."""
    texel_m: float = dataclasses.field(metadata=dict(static=True))


class Ground(NamedTuple):
    """Where world points lie on the floor."""

    texel: Float[Array, "*s 2"]
    """(column, row) of the texture."""
    direction: Float[Array, "*s 2"]
    """Of their strip."""
    along: Float[Array, "*s"]
    """From its beginning, m."""
    across: Float[Array, "*s"]
    """To the left of its middle, m."""
    clearance: Float[Array, "*s"]
    """To the nearest side of any strip that holds the point, m; below 0 outside."""


def locate(atlas: Atlas, x: Float[Array, "*s"], y: Float[Array, "*s"]) -> Ground:
    """Finds the first strip that holds each point; points outside all are as if on the first."""
    strips = atlas.origins, atlas.directions, atlas.lengths, atlas.columns

    def inside(origin, direction, length):
        dx, dy = x - origin[..., 0], y - origin[..., 1]
        u = dx * direction[..., 0] + dy * direction[..., 1]
        v = dy * direction[..., 0] - dx * direction[..., 1]
        return u, v, jnp.minimum(jnp.minimum(u, length - u), jnp.minimum(v, atlas.width_m - v))

    def step(seen, number):
        strip, clearance = seen
        inner = inside(*(column[number] for column in strips[:3]))[2]
        return (jnp.where((clearance < 0) & (inner >= 0), number, strip), jnp.maximum(clearance, inner)), None

    start = jnp.zeros(x.shape, jnp.int32), inside(*(column[0] for column in strips[:3]))[2]
    (strip, clearance), _ = jax.lax.scan(step, start, jnp.arange(1, len(atlas.lengths), dtype=jnp.int32))
    # What many readers fuse with, XLA computes again for each of them.
    strip, clearance = jax.lax.optimization_barrier((strip, clearance))
    direction = atlas.directions[strip]
    u, v, _ = inside(atlas.origins[strip], direction, 0.0)
    texel = jnp.stack([u / atlas.texel_m + atlas.columns[strip] - 0.5, v / atlas.texel_m - 0.5], axis=-1)
    return Ground(texel, direction, u, v - atlas.width_m / 2, clearance)


def look(atlas: Atlas, ground: Ground, by_pixel: Float[Array, "*s 2 2"]) -> Float[Array, "*s C"]:
    """Reflectance of the floor, filtered over a pixel; `by_pixel` has the rows d(x, y)/d(pixel u), d(x, y)/d(v)."""
    c, s = ground.direction[..., None, 0], ground.direction[..., None, 1]
    axes = jnp.stack(
        [by_pixel[..., 0] * c + by_pixel[..., 1] * s, by_pixel[..., 1] * c - by_pixel[..., 0] * s], axis=-1
    )
    return mipmap.sample_anisotropic(atlas.texture, ground.texel, axes / atlas.texel_m)


def make_atlas(
    image: Float[np.ndarray, "H W C"], columns: list[int], plan: Plan, texel_m: float, dtype: DTypeLike = jnp.float32
) -> Atlas:
    """An atlas of one image in which a plan's strips lie side by side.

    Args:
      image: row 0 is the right side of each strip, seen along it.
      columns: at which each rectangle begins.
      plan: whose rectangles the strips cover.
      texel_m: side of a texel.
      dtype: of directions and lengths, not of the texels.
    """
    origins, directions, lengths, width_m, starts = (
        jnp.asarray(n, dtype) for n in (plan.origins, plan.directions, plan.lengths, plan.width_m, columns)
    )
    return Atlas(mipmap.build(image, LEVELS), origins, directions, lengths, width_m, starts, texel_m)


@partial(jax.jit, static_argnames=("shape", "floor"))
def _block(
    corner: Float[Array, "2"],
    direction: Float[Array, "2"],
    shape: tuple[int, int],
    floor: Material,
    photographs: tuple[Float[Array, "N n n 3"], ...],
    *,
    key: Key[Array, ""],
) -> Float[Array, "H W C"]:
    """Clean floor under its grime: texel (column, row) at corner + (column + 1/2) along + (row + 1/2) to the left."""
    height, width = shape
    u, v = jnp.meshgrid(*((jnp.arange(n, dtype=corner.dtype) + 0.5) * floor.texel_m for n in (width, height)))
    c, s = direction[0], direction[1]
    points = jnp.stack([corner[0] + c * u - s * v, corner[1] + s * u + c * v], axis=-1)
    own, coarse, fine = jax.random.split(key, 3)
    colour = family(floor.family).reflectance(points, floor, *photographs, key=own)
    grime = fractal_noise(1.5 * points, key=coarse, home=1.5 * HOME_M)
    grime = grime + 0.5 * fractal_noise(5.0 * points, key=fine, octaves=3, home=5.0 * HOME_M)
    return colour * (1 + 0.1 * floor.dirt * grime)[..., None]


def floor_of(
    plan: Plan, config: FloorConfig, *, key: Key[Array, ""], photographs: Float[np.ndarray, "N n n 3"] | None = None
) -> Atlas:
    """Lays the floor of a plan: the family, grime, marks of wear; a pure function of the key.

    Args:
      plan: its corridors.
      config: the floor.
      key: of everything random.
      photographs: what the family "photograph" lays.
    """
    own = material(config)
    if photographs is not None and config.designs is None:
        own = own._replace(designs=len(photographs))
    floor_key, mark_key, place_key = jax.random.split(key, 3)
    extra = () if photographs is None else (jnp.asarray(photographs, jnp.float32),)
    texel = config.texel_m
    rows = -(-math.ceil(plan.width_m / texel) // 2 ** (LEVELS - 1)) * 2 ** (LEVELS - 1)
    sizes = np.stack([plan.lengths, np.full(len(plan.lengths), plan.width_m)], axis=1)
    rng = np.random.default_rng(np.asarray(jax.random.key_data(place_key)))
    shares = family(config.family).marks
    marks = wear.scatter(plan.owns, plan.origins, plan.directions, sizes, config.wear_per_m2, shares, rng)
    marks = {name: kind for name, kind in marks.items() if len(kind.places) and config.wear > 0}

    spans = [(i, k * BLOCK) for i, n in enumerate(plan.lengths) for k in range(_blocks(n, texel))]
    centres = {name: [_local(plan, span, texel, kind.places) for span in spans] for name, kind in marks.items()}
    reach = {name: wear.KINDS[name].patch_m / texel for name in marks}
    near = {name: [_reaches(at, reach[name], rows) for at in blocks] for name, blocks in centres.items()}
    # One number of marks for all blocks, and so one program a kind.
    most = {name: 1 << (max(map(len, blocks)) - 1).bit_length() for name, blocks in near.items()}

    def block(number: int) -> Float[np.ndarray, "H W C"]:
        strip, _ = spans[number]
        direction = jnp.asarray(plan.directions[strip], jnp.float32)
        corner = jnp.asarray(_corner(plan, spans[number], texel), jnp.float32)
        floor = _block(corner, direction, (rows, BLOCK), own, extra, key=floor_key)
        for order, (name, kind) in enumerate(marks.items()):
            chosen = near[name][number]
            if len(chosen) == 0:
                continue
            padded = np.resize(chosen, most[name])
            floor = wear.paint(
                floor,
                name,
                jnp.asarray(centres[name][number][padded], jnp.float32),
                jnp.asarray(kind.numbers[padded], jnp.int32),
                jnp.arange(most[name]) < len(chosen),
                direction,
                jnp.float32(config.wear),
                texel,
                key=jax.random.fold_in(mark_key, order),
            )
        floor = floor.at[..., :3].set(jnp.clip(floor[..., :3], 0.01, 0.95))
        return np.asarray(floor, np.float16)

    # In place: half a gigabyte is too much to hold several times.
    first = block(0)
    image = np.empty((rows, BLOCK * len(spans), first.shape[2]), np.float16)
    for number in range(len(spans)):
        image[:, number * BLOCK : (number + 1) * BLOCK] = first if number == 0 else block(number)
    columns = [BLOCK * number + GUTTER for number, (_, start) in enumerate(spans) if start == 0]
    return make_atlas(image, columns, plan, texel)


def _blocks(length_m: float, texel_m: float) -> int:
    return math.ceil((length_m / texel_m + 2 * GUTTER) / BLOCK)


def _corner(plan: Plan, span: tuple[int, int], texel_m: float) -> Float[np.ndarray, "2"]:
    strip, first = span
    return plan.origins[strip] + (first - GUTTER) * texel_m * plan.directions[strip]


def _local(plan: Plan, span: tuple[int, int], texel_m: float, places: np.ndarray) -> Float[np.ndarray, "N 2"]:
    """World points as (column, row) of a block."""
    along = plan.directions[span[0]]
    frame = np.stack([along, [-along[1], along[0]]], axis=1)
    return (places - _corner(plan, span, texel_m)) @ frame / texel_m - 0.5


def _reaches(at: Float[np.ndarray, "N 2"], reach_px: float, rows: int) -> Int[np.ndarray, " K"]:
    """Which marks reach into a block."""
    return np.flatnonzero(np.all((at > -reach_px) & (at < np.array([BLOCK, rows]) + reach_px), axis=1))
