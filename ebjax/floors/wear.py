"""What makes one square metre of floor unlike the next: stains, cracks, scratches, chips, gum, repairs.

A mark is a pure function (key, grid of its patch, m) -> (opacity, colour); `KINDS` names it and its patch. Marks lie in
the world: `scatter` places them, `paint` brings those that reach into a patch of floor onto it, whatever its frame.
"""

import itertools
from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from ebjax.floors.noise import fractal_noise

Painted = tuple[Float[Array, "P Q"], Float[Array, "3"]]


class Kind(NamedTuple):
    """How a mark is painted, and the side of the patch that holds it, m."""

    paint: Callable[..., Painted]
    patch_m: float


def _uniform(keys: Key[Array, " K"], *ranges: tuple[float, float], like: Float[Array, "..."]) -> list[Float[Array, ""]]:
    """A number of each key, from low to high. Drawn side by side, as XLA compiles every draw of its own anew."""
    low, high = (jnp.array(ends, like.dtype) for ends in zip(*ranges, strict=True))
    return list(jax.vmap(lambda key, a, b: jax.random.uniform(key, (), like.dtype, a, b))(keys, low, high))


def _grey(reflectance: Float[Array, ""]) -> Float[Array, "3"]:
    """A grey of the given reflectance, slightly warm."""
    return reflectance * jnp.array([1.0, 0.94, 0.86], reflectance.dtype)


def _distance_to_path(grid: Float[Array, "P Q 2"], corners: Float[Array, "K 2"]) -> Float[Array, "P Q"]:
    """Distance to a polyline, m."""
    start, side = corners[None, None, :-1], jnp.diff(corners, axis=0)[None, None]
    offset = grid[:, :, None] - start
    along = jnp.sum(offset * side, axis=-1) / jnp.maximum(jnp.sum(side**2, axis=-1), 1e-12)
    nearest = offset - jnp.clip(along, 0, 1)[..., None] * side
    return jnp.sqrt(jnp.min(jnp.sum(nearest**2, axis=-1), axis=-1))


def _random_walk(
    key: Key[Array, ""], corners: int, step_m: float, turn_rad: float, like: Float[Array, "..."]
) -> Float[Array, "K 2"]:
    start, turns = jax.random.split(key)
    bend = turn_rad * jax.random.normal(turns, (corners - 1,), like.dtype)
    heading = jax.random.uniform(start, (), like.dtype, 0.0, 2 * jnp.pi) + jnp.cumsum(bend)
    walk = jnp.cumsum(step_m * jnp.stack([jnp.cos(heading), jnp.sin(heading)], axis=-1), axis=0)
    walk = jnp.concatenate([jnp.zeros((1, 2), like.dtype), walk])
    return walk - jnp.mean(walk, axis=0, keepdims=True)


def _blob(
    key: Key[Array, ""], grid: Float[Array, "P Q 2"], radius_m: Float[Array, ""], rough: float
) -> Float[Array, "P Q"]:
    """Signed distance-like field of an irregular blob, m; negative inside."""
    keys = jax.random.split(key, 3)
    ratio, angle = _uniform(keys[1:], (0.55, 1.0), (0.0, jnp.pi), like=grid)
    c, s = jnp.cos(angle), jnp.sin(angle)
    local = jnp.stack([c * grid[..., 0] + s * grid[..., 1], (c * grid[..., 1] - s * grid[..., 0]) / ratio], axis=-1)
    radius = jnp.sqrt(jnp.sum(local**2, axis=-1) + 1e-12)
    return radius - radius_m * (1 + rough * fractal_noise(local / radius_m, key=keys[0], octaves=3))


def stain(key: Key[Array, ""], grid: Float[Array, "P Q 2"]) -> Painted:
    """A dried spill: soft, translucent, darker at its rim."""
    keys = jax.random.split(key, 5)
    radius, tint, depth, rim = _uniform(keys[1:], (0.02, 0.09), (0.08, 0.3), (0.15, 0.5), (0.0, 0.3), like=grid)
    distance = _blob(keys[0], grid, radius, 0.9)
    inside = jax.nn.sigmoid(-distance / (0.1 * radius))
    ring = jnp.exp(-((distance / (0.12 * radius)) ** 2))
    return jnp.clip(inside * depth + ring * rim, 0, 1), _grey(tint)


def crack(key: Key[Array, ""], grid: Float[Array, "P Q 2"]) -> Painted:
    """A dark broken line that tapers to nothing."""
    keys = jax.random.split(key, 3)
    distance = _distance_to_path(grid, _random_walk(keys[0], 8, 0.045, 0.7, grid))
    half, tint = _uniform(keys[1:], (0.0012, 0.0035), (0.04, 0.12), like=grid)
    return 0.9 * jax.nn.sigmoid((half - distance) / 0.0008), _grey(tint)


def scratch(key: Key[Array, ""], grid: Float[Array, "P Q 2"]) -> Painted:
    """A long faint scuff, nearly straight, lighter or darker than the floor."""
    keys = jax.random.split(key, 4)
    distance = _distance_to_path(grid, _random_walk(keys[0], 4, 0.12, 0.12, grid))
    half, tint, depth = _uniform(keys[1:], (0.001, 0.004), (0.1, 0.9), (0.2, 0.6), like=grid)
    return depth * jax.nn.sigmoid((half - distance) / 0.001), _grey(tint)


def chip(key: Key[Array, ""], grid: Float[Array, "P Q 2"]) -> Painted:
    """A small hole in the glaze: sharp, irregular, dark or pale."""
    keys = jax.random.split(key, 3)
    radius, tint = _uniform(keys[1:], (0.005, 0.018), (0.04, 0.5), like=grid)
    return 0.9 * jax.nn.sigmoid(-_blob(keys[0], grid, radius, 1.2) / 0.001), _grey(tint)


def gum(key: Key[Array, ""], grid: Float[Array, "P Q 2"]) -> Painted:
    """A trodden blob of chewing gum or a drop of paint: round, opaque, dark."""
    keys = jax.random.split(key, 3)
    radius, tint = _uniform(keys[1:], (0.008, 0.022), (0.03, 0.12), like=grid)
    return 0.8 * jax.nn.sigmoid(-_blob(keys[0], grid, radius, 0.35) / 0.0015), _grey(tint)


def repair(key: Key[Array, ""], grid: Float[Array, "P Q 2"]) -> Painted:
    """A filled hole or trench: a ragged rectangle of another grey with a darker rim."""
    keys = jax.random.split(key, 5)
    half = jax.random.uniform(keys[1], (2,), grid.dtype, 0.05, 0.17)
    angle, tint, depth = _uniform(keys[2:], (0.0, jnp.pi), (0.15, 0.5), (0.35, 0.75), like=grid)
    c, s = jnp.cos(angle), jnp.sin(angle)
    local = jnp.stack([c * grid[..., 0] + s * grid[..., 1], c * grid[..., 1] - s * grid[..., 0]], axis=-1)
    outside = jnp.max(jnp.abs(local) - half[None, None, :], axis=-1)
    distance = outside + 0.012 * fractal_noise(grid / 0.03, key=keys[0], octaves=3)
    rim = 0.35 * jnp.exp(-((distance / 0.004) ** 2))
    return jnp.clip(depth * jax.nn.sigmoid(-distance / 0.0015) + rim, 0, 1), _grey(tint)


KINDS = {
    "stain": Kind(stain, 0.36),
    "crack": Kind(crack, 0.40),
    "scratch": Kind(scratch, 0.44),
    "chip": Kind(chip, 0.06),
    "gum": Kind(gum, 0.08),
    "repair": Kind(repair, 0.56),
}


class Marks(NamedTuple):
    """All marks of one kind: where they lie in the world, m, and which key each has."""

    places: Float[np.ndarray, "N 2"]
    numbers: Int[np.ndarray, " N"]


def scatter(
    owns: Callable[[int, np.ndarray], np.ndarray],
    origins: Float[np.ndarray, "S 2"],
    directions: Float[np.ndarray, "S 2"],
    sizes: Float[np.ndarray, "S 2"],
    per_m2: float,
    shares: Mapping[str, float],
    rng: np.random.Generator,
) -> dict[str, Marks]:
    """Uniformly random places on rectangles that may overlap; where they do, the first one owns the floor.

    Args:
      owns: (rectangle, points) -> whether the points are its own.
      origins: corner of each rectangle, world, m.
      directions: unit vector along its length.
      sizes: length and width, m.
      per_m2: expected marks of all kinds.
      shares: of each kind.
      rng: of numbers and places.
    """
    places = []
    for i, (origin, direction, size) in enumerate(zip(origins, directions, sizes, strict=True)):
        local = rng.uniform(size=(rng.poisson(per_m2 * size.prod()), 2)) * size
        points = origin + local[:, :1] * direction + local[:, 1:] * np.array([-direction[1], direction[0]])
        places.append(points[owns(i, points)])
    everywhere = np.concatenate(places)
    kind = rng.uniform(size=len(everywhere))
    bounds = np.concatenate([[0.0], np.cumsum(list(shares.values()))])
    numbers = np.arange(len(everywhere))
    of_kind = [(kind >= low) & (kind < high) for low, high in itertools.pairwise(bounds)]
    return {name: Marks(everywhere[own], numbers[own]) for name, own in zip(shares, of_kind, strict=True)}


@partial(jax.jit, static_argnames=("kind", "texel_m"))
def paint(
    floor: Float[Array, "H W C"],
    kind: str,
    centres: Float[Array, "N 2"],
    numbers: Int[Array, " N"],
    valid: Bool[Array, " N"],
    direction: Float[Array, "2"],
    strength: Float[Array, ""],
    texel_m: float,
    *,
    key: Key[Array, ""],
) -> Float[Array, "H W C"]:
    """Paints marks of one kind one after another; those beyond the border are cut there.

    Args:
      floor: linear reflectance, columns along `direction`; further channels vanish under marks.
      kind: name in `KINDS`.
      centres: of the marks, (column, row), px.
      numbers: of the marks: what their keys are made of.
      valid: marks to paint; the others are there to make the number of marks a fixed one.
      direction: of the columns in the world, a unit vector: marks keep their orientation in the world.
      strength: of the marks, 0 to 1.
      texel_m: side of a texel.
      key: of all shapes.
    """
    height, width, channels = floor.shape
    side = round(KINDS[kind].patch_m / texel_m) + 2
    ticks = jnp.arange(side, dtype=floor.dtype)

    def step(canvas, mark):
        centre, number, is_real = mark
        corner = jnp.clip(jnp.floor(centre - side / 2), -side, jnp.array([width, height], floor.dtype))
        u, v = jnp.meshgrid((ticks + corner[0] - centre[0]) * texel_m, (ticks + corner[1] - centre[1]) * texel_m)
        c, s = direction[0], direction[1]
        opacity, colour = KINDS[kind].paint(
            jax.random.fold_in(key, number), jnp.stack([c * u - s * v, s * u + c * v], -1)
        )
        share = (is_real * strength * opacity)[..., None]
        at = (corner[1].astype(jnp.int32) + side, corner[0].astype(jnp.int32) + side, jnp.int32(0))
        patch = jax.lax.dynamic_slice(canvas, at, (side, side, channels))
        colour = jnp.pad(colour, (0, channels - 3))
        return jax.lax.dynamic_update_slice(canvas, patch * (1 - share) + share * colour[None, None, :], at), None

    canvas = jnp.pad(floor, ((side, side), (side, side), (0, 0)))
    canvas, _ = jax.lax.scan(step, canvas, (centres, numbers, valid))
    return canvas[side : side + height, side : side + width]
