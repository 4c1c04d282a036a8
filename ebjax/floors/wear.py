"""What makes one square metre of floor unlike the next: stains, cracks, scratches and chips, painted over the tiles.

A mark is a pure function (key, grid of its patch, m) -> (opacity, colour); `KINDS` names it, its patch and its share.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from ebjax.floors.noise import fractal_noise

Painted = tuple[Float[Array, "P Q"], Float[Array, "3"]]


class Kind(NamedTuple):
    """How a mark is painted, the side of the patch that holds it (m), and its share of all marks."""

    paint: Callable[..., Painted]
    patch_m: float
    share: float


def _uniform(key: Key[Array, ""], low: float, high: float, like: Float[Array, "..."]) -> Float[Array, ""]:
    return jax.random.uniform(key, (), like.dtype, low, high)


def _grey(key: Key[Array, ""], low: float, high: float, like: Float[Array, "..."]) -> Float[Array, "3"]:
    """A grey of the given reflectance, slightly warm."""
    return _uniform(key, low, high, like) * jnp.array([1.0, 0.94, 0.86], like.dtype)


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
    heading = _uniform(start, 0.0, 2 * jnp.pi, like) + jnp.cumsum(bend)
    walk = jnp.cumsum(step_m * jnp.stack([jnp.cos(heading), jnp.sin(heading)], axis=-1), axis=0)
    walk = jnp.concatenate([jnp.zeros((1, 2), like.dtype), walk])
    return walk - jnp.mean(walk, axis=0, keepdims=True)


def _blob(
    key: Key[Array, ""], grid: Float[Array, "P Q 2"], radius_m: Float[Array, ""], rough: float
) -> Float[Array, "P Q"]:
    """Signed distance-like field of an irregular blob, m; negative inside."""
    shape, stretch, turn = jax.random.split(key, 3)
    angle, ratio = _uniform(turn, 0.0, jnp.pi, grid), _uniform(stretch, 0.55, 1.0, grid)
    c, s = jnp.cos(angle), jnp.sin(angle)
    local = jnp.stack([c * grid[..., 0] + s * grid[..., 1], (c * grid[..., 1] - s * grid[..., 0]) / ratio], axis=-1)
    radius = jnp.sqrt(jnp.sum(local**2, axis=-1) + 1e-12)
    return radius - radius_m * (1 + rough * fractal_noise(local / radius_m, key=shape, octaves=3))


def stain(key: Key[Array, ""], grid: Float[Array, "P Q 2"]) -> Painted:
    """A dried spill: soft, translucent, darker at its rim."""
    shape, size, tint, depth, rim = jax.random.split(key, 5)
    radius = _uniform(size, 0.02, 0.09, grid)
    distance = _blob(shape, grid, radius, 0.9)
    inside = jax.nn.sigmoid(-distance / (0.1 * radius))
    ring = jnp.exp(-((distance / (0.12 * radius)) ** 2))
    opacity = inside * _uniform(depth, 0.15, 0.5, grid) + ring * _uniform(rim, 0.0, 0.3, grid)
    return jnp.clip(opacity, 0, 1), _grey(tint, 0.08, 0.3, grid)


def crack(key: Key[Array, ""], grid: Float[Array, "P Q 2"]) -> Painted:
    """A dark broken line that tapers to nothing."""
    path, width, tint = jax.random.split(key, 3)
    distance = _distance_to_path(grid, _random_walk(path, 8, 0.045, 0.7, grid))
    half = _uniform(width, 0.0012, 0.0035, grid)
    return 0.9 * jax.nn.sigmoid((half - distance) / 0.0008), _grey(tint, 0.04, 0.12, grid)


def scratch(key: Key[Array, ""], grid: Float[Array, "P Q 2"]) -> Painted:
    """A long faint scuff, nearly straight, lighter or darker than the floor."""
    path, width, tint, depth = jax.random.split(key, 4)
    distance = _distance_to_path(grid, _random_walk(path, 4, 0.12, 0.12, grid))
    half = _uniform(width, 0.001, 0.004, grid)
    return _uniform(depth, 0.2, 0.6, grid) * jax.nn.sigmoid((half - distance) / 0.001), _grey(tint, 0.1, 0.9, grid)


def chip(key: Key[Array, ""], grid: Float[Array, "P Q 2"]) -> Painted:
    """A small hole in the glaze: sharp, irregular, dark or pale."""
    shape, size, tint = jax.random.split(key, 3)
    distance = _blob(shape, grid, _uniform(size, 0.005, 0.018, grid), 1.2)
    return 0.9 * jax.nn.sigmoid(-distance / 0.001), _grey(tint, 0.04, 0.5, grid)


KINDS = {
    "stain": Kind(stain, 0.36, 0.35),
    "crack": Kind(crack, 0.40, 0.15),
    "scratch": Kind(scratch, 0.44, 0.2),
    "chip": Kind(chip, 0.06, 0.3),
}


def paint(
    floor: Float[Array, "H W 3"], marks_per_m2: float, texel_m: float, *, key: Key[Array, ""]
) -> Float[Array, "H W 3"]:
    """Paints marks at uniformly random places, one after another; density 0 leaves the floor as it is.

    Args:
      floor: linear reflectance.
      marks_per_m2: expected number of marks of all kinds.
      texel_m: side of a texel.
      key: of places and shapes.
    """
    height, width, _ = floor.shape
    area_m2 = height * width * texel_m**2
    for kind_key, kind in zip(jax.random.split(key, len(KINDS)), KINDS.values(), strict=True):
        count = round(kind.share * marks_per_m2 * area_m2)
        side = min(round(kind.patch_m / texel_m), height, width)
        axis = (jnp.arange(side, dtype=floor.dtype) - (side - 1) / 2) * texel_m
        grid = jnp.stack(jnp.meshgrid(axis, axis), axis=-1)

        def step(canvas, mark_key, kind=kind, side=side, grid=grid):
            place, look = jax.random.split(mark_key)
            # Patches may hang over the border by half: the canvas is padded, so the density stays even up to the walls.
            row, column = jax.random.randint(place, (2,), 0, jnp.array([height, width]))
            opacity, colour = kind.paint(look, grid)
            patch = jax.lax.dynamic_slice(canvas, (row, column, 0), (side, side, 3))
            patch = patch * (1 - opacity[..., None]) + opacity[..., None] * colour[None, None, :]
            return jax.lax.dynamic_update_slice(canvas, patch, (row, column, 0)), None

        margin = side // 2
        canvas = jnp.pad(floor, ((margin, side), (margin, side), (0, 0)), mode="edge")
        canvas, _ = jax.lax.scan(step, canvas, jax.random.split(kind_key, count))
        floor = canvas[margin : margin + height, margin : margin + width]
    return floor
