"""Voronoi cells in the plane: what stone chips are cut out of, and where pores lie."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from ebjax.floors.lattice import entry


class Cell(NamedTuple):
    """The cell in which a point lies; lengths in lattice cells."""

    edge: Float[Array, "*s"]
    """(second - first) / 2 of the distances to the nearest seeds: 0 on the edges between cells."""
    seed: Float[Array, "*s"]
    """Distance to the cell's seed."""
    random: Float[Array, "*s 4"]
    """Four numbers in [0, 1) of the cell's own."""


def voronoi(points: Float[Array, "*s 2"], *, key: Key[Array, ""], side: int = 128) -> Cell:
    """One seed a lattice cell, at a random place in it; nothing repeats.

    Args:
      points: (x, y) in lattice cells.
      key: of the seeds.
      side: of the table of seeds, cells.
    """
    table = jax.random.uniform(key, (side * side, 6), points.dtype)
    corner = jnp.floor(jax.lax.stop_gradient(points))
    cell = corner.astype(jnp.int32)

    def nearer(carry, shift):
        first, second, index = carry
        at = entry(cell[..., 0] + shift[0], cell[..., 1] + shift[1], (side, side), side)
        x = table[at, 0] + corner[..., 0] + shift[0]
        y = table[at, 1] + corner[..., 1] + shift[1]
        distance = jnp.sqrt((points[..., 0] - x) ** 2 + (points[..., 1] - y) ** 2)
        second = jnp.minimum(second, jnp.maximum(first, distance))
        index = jnp.where(distance < first, at, index)
        return (jnp.minimum(first, distance), second, index), None

    shifts = jnp.stack(jnp.meshgrid(jnp.arange(-1, 2), jnp.arange(-1, 2)), axis=-1).reshape(-1, 2).astype(jnp.int32)
    far = jnp.full(points.shape[:-1], 9.0, points.dtype)
    # A loop, not nine terms: fused gathers take XLA long to compile.
    (first, second, index), _ = jax.lax.scan(nearer, (far, far, jnp.zeros_like(cell[..., 0])), shifts)
    return Cell((second - first) / 2, first, table[index, 2:])
