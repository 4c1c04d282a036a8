"""Which entry of a small random table each cell of an endless lattice takes, so that nothing repeats.

A table laid side by side repeats after its side. So it is laid in order only around the origin, in the cells that a
world of some tens of metres covers (its home); every cell outside takes any entry, by a hash of its column and row.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int, UInt32

HOME_M = 64.0
"""Home of what is too faint to be recognised by, m: grime, the wobble of edges."""


def _mixed(number: UInt32[Array, "*s"]) -> UInt32[Array, "*s"]:
    """A bijection of the 32-bit numbers whose upper bits depend on all."""
    number = number * jnp.uint32(0x7FEB352D)
    return (number ^ (number >> 15)) * jnp.uint32(0x846CA68B)


def entry(
    column: Int[Array, "*s"],
    row: Int[Array, "*s"],
    size: tuple[int, int],
    home: float | int | Float[Array, ""] | None,
) -> Int[Array, "*s"]:
    """Row-major index into a table.

    Args:
      column: of the cell; any integer.
      row: of the cell.
      size: columns and rows of the table, powers of two.
      home: cells from -home / 8 to below 7 / 8 home, along both axes, take column % columns and row % rows. None: all
        do, and the lattice repeats. More than a side of the table: it repeats there.
    """
    columns, rows = size
    bits = (columns * rows).bit_length() - 1
    assert columns * rows == 1 << bits
    in_order = (row & (rows - 1)) * columns + (column & (columns - 1))
    if home is None:
        return in_order
    side, before = jnp.asarray(home).astype(jnp.uint32), jnp.asarray(home / 8).astype(jnp.uint32)
    x, y = column.astype(jnp.uint32), row.astype(jnp.uint32)
    near = (x + before < side) & (y + before < side)
    # Nested: a sum of both, mixed once, would be the same again at some far column and row.
    mixed = _mixed(x)
    hashed = _mixed((mixed ^ (mixed >> 16)) + y) >> (32 - bits)
    return jnp.where(near, in_order, hashed.astype(in_order.dtype))
