"""Lays the floor of a plan: the family, grime, marks of wear.

Strips sample one endless floor in world coordinates: where corridors meet, tiles and marks go on. Made block by block,
one program for all.
"""

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from ebjax.floors import wear
from ebjax.floors.atlas import LEVELS, Atlas, make_atlas
from ebjax.floors.lattice import HOME_M
from ebjax.floors.noise import fractal_noise
from ebjax.floors.plan import Plan
from ebjax.floors.surface import FloorConfig, Material, family, material

BLOCK = 1024
GUTTER = 64


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


class Blocks(NamedTuple):
    """The texture of a plan's floor, cut into blocks of equal size: strip after strip, along each."""

    plan: Plan
    texel_m: float
    rows: int
    spans: list[tuple[int, int]]
    """Strip of each block, and the texel of the strip, its gutter counted, at which it begins."""

    def corner(self, number: int) -> Float[np.ndarray, "2"]:
        """World point of a block's corner."""
        strip, first = self.spans[number]
        return self.plan.origins[strip] + (first - GUTTER) * self.texel_m * self.direction(number)

    def direction(self, number: int) -> Float[np.ndarray, "2"]:
        """Unit vector along its columns."""
        return np.asarray(self.plan.directions[self.spans[number][0]])

    def local(self, number: int, places: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N 2"]:
        """World points as (column, row) of a block."""
        along = self.direction(number)
        frame = np.stack([along, [-along[1], along[0]]], axis=1)
        return (places - self.corner(number)) @ frame / self.texel_m - 0.5

    def columns_of(self, number: int) -> slice:
        """Where a block lies in the texture."""
        return slice(number * BLOCK, (number + 1) * BLOCK)

    def atlas(self, image: Float[np.ndarray, "H W C"]) -> Atlas:
        """The atlas of the whole texture."""
        columns = [BLOCK * number + GUTTER for number, (_, start) in enumerate(self.spans) if start == 0]
        return make_atlas(image, columns, self.plan, self.texel_m)


def blocks_of(plan: Plan, texel_m: float) -> Blocks:
    """Cuts a plan's floor into blocks."""
    rows = -(-math.ceil(plan.width_m / texel_m) // 2 ** (LEVELS - 1)) * 2 ** (LEVELS - 1)
    counts = [math.ceil((length / texel_m + 2 * GUTTER) / BLOCK) for length in plan.lengths]
    return Blocks(plan, texel_m, rows, [(i, k * BLOCK) for i, count in enumerate(counts) for k in range(count)])


def marks_on(plan: Plan, config: FloorConfig, per_m2: float, *, key: Key[Array, ""]) -> dict[str, wear.Marks]:
    """Where the floor of a plan is worn: marks by kind."""
    sizes = np.stack([plan.lengths, np.full(len(plan.lengths), plan.width_m)], axis=1)
    rng = np.random.default_rng(np.asarray(jax.random.key_data(key)))
    shares = family(config.family).marks
    marks = wear.scatter(plan.owns, plan.origins, plan.directions, sizes, per_m2, shares, rng)
    return {name: kind for name, kind in marks.items() if len(kind.places) and config.wear > 0}


def painter(
    blocks: Blocks, marks: dict[str, wear.Marks], strength: float, *, key: Key[Array, ""]
) -> Callable[[int, Float[Array, "H W C"]], Float[Array, "H W C"]]:
    """(number of a block, its floor) -> the same with all marks that reach into it."""
    numbers = range(len(blocks.spans))
    centres = {name: [blocks.local(k, kind.places) for k in numbers] for name, kind in marks.items()}
    reach = {name: wear.KINDS[name].patch_m / blocks.texel_m for name in marks}
    near = {name: [_reaches(at, reach[name], blocks.rows) for at in each] for name, each in centres.items()}
    # One number of marks for all blocks, and so one program a kind; eight at least, so that many floors share it.
    most = {name: max(8, 1 << (max(map(len, each)) - 1).bit_length()) for name, each in near.items()}

    def paint(number: int, floor: Float[Array, "H W C"]) -> Float[Array, "H W C"]:
        _compile(tuple(most.items()), floor.shape, blocks.texel_m)
        direction = np.asarray(blocks.direction(number), np.float32)
        for order, (name, kind) in enumerate(marks.items()):
            chosen = near[name][number]
            if len(chosen) == 0:
                continue
            padded = np.resize(chosen, most[name])
            # NumPy's casts: those of JAX are a program a shape, to compile before anything is seen.
            floor = wear.paint(
                floor,
                name,
                np.asarray(centres[name][number][padded], np.float32),
                np.asarray(kind.numbers[padded], np.int32),
                np.arange(most[name]) < len(chosen),
                direction,
                np.float32(strength),
                blocks.texel_m,
                key=jax.random.fold_in(key, order),
            )
        return floor.at[..., :3].set(jnp.clip(floor[..., :3], 0.01, 0.95))

    return paint


@lru_cache(maxsize=16)
def _compile(most: tuple[tuple[str, int], ...], shape: tuple[int, ...], texel_m: float) -> None:
    """Compiles the programs of all kinds of marks beside each other, once; JAX would do it one after another."""

    def compile_kind(one: tuple[str, int]) -> None:
        (name, count), floor, direction = one, np.zeros(shape, np.float32), np.zeros(2, np.float32)
        none = np.zeros((count, 2), np.float32), np.zeros(count, np.int32), np.zeros(count, bool)
        wear.paint(floor, name, *none, direction, np.float32(0), texel_m, key=jax.random.key(0))

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(compile_kind, most))


def lay(
    blocks: Blocks,
    config: FloorConfig,
    *,
    key: Key[Array, ""],
    photographs: Float[np.ndarray, "N n n 3"] | None = None,
) -> Float[np.ndarray, "H W C"]:
    """The texture, float16: the family, grime, marks of wear; a pure function of the key.

    Args:
      blocks: of the plan.
      config: the floor.
      key: of everything random.
      photographs: what the family "photograph" lays.
    """
    own = material(config)
    if photographs is not None and config.designs is None:
        own = own._replace(designs=len(photographs))
    floor_key, mark_key, place_key = jax.random.split(key, 3)
    extra = () if photographs is None else (jnp.asarray(photographs, jnp.float32),)
    marks = marks_on(blocks.plan, config, config.wear_per_m2, key=place_key)
    paint = painter(blocks, marks, config.wear, key=mark_key)

    def block(number: int) -> Float[np.ndarray, "H W C"]:
        corner, direction = (np.asarray(at(number), np.float32) for at in (blocks.corner, blocks.direction))
        clean = _block(corner, direction, (blocks.rows, BLOCK), own, extra, key=floor_key)
        return np.asarray(paint(number, clean), np.float16)

    # In place: half a gigabyte is too much to hold several times.
    first = block(0)
    image = np.empty((blocks.rows, BLOCK * len(blocks.spans), first.shape[2]), np.float16)
    for number in range(len(blocks.spans)):
        image[:, blocks.columns_of(number)] = first if number == 0 else block(number)
    return image


def floor_of(
    plan: Plan, config: FloorConfig, *, key: Key[Array, ""], photographs: Float[np.ndarray, "N n n 3"] | None = None
) -> Atlas:
    """The floor of a plan as it is at first; see `lay`."""
    blocks = blocks_of(plan, config.texel_m)
    return blocks.atlas(lay(blocks, config, key=key, photographs=photographs))


def _reaches(at: Float[np.ndarray, "N 2"], reach_px: float, rows: int) -> Int[np.ndarray, " K"]:
    """Which marks reach into a block."""
    return np.flatnonzero(np.all((at > -reach_px) & (at < np.array([BLOCK, rows]) + reach_px), axis=1))
