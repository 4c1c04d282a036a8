"""A 3x3 convolution as one batched product: Winograd's F(4x4, 3x3) (Lavin and Gray, CVPR 2016).

Tiles of 4x4 outputs take 36 products a channel pair instead of 144. To float32 rounding it is the same convolution
(about 1e-5 of the largest value); it pays where there are many channels, and compiles slowly.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

TILE = 4
SMALL = 256
"""Tiles from which 36 products are faster than one batched product."""
Matrix = tuple[tuple[float | int, ...], ...]
INPUT: Matrix = (
    (4, 0, -5, 0, 1, 0),
    (0, -4, -4, 1, 1, 0),
    (0, 4, -4, -1, 1, 0),
    (0, -2, -1, 2, 1, 0),
    (0, 2, -1, -2, 1, 0),
    (0, 4, 0, -5, 0, 1),
)
KERNEL: Matrix = (
    (1 / 4, 0, 0),
    (-1 / 6, -1 / 6, -1 / 6),
    (-1 / 6, 1 / 6, -1 / 6),
    (1 / 24, 1 / 12, 1 / 6),
    (1 / 24, -1 / 12, 1 / 6),
    (0, 0, 1),
)
OUTPUT: Matrix = ((1, 1, 1, 1, 1, 0), (0, 1, -1, 2, -2, 0), (0, 1, 1, 4, 4, 0), (0, 1, -1, 8, -8, 1))


def winograd_kernel(kernel: Float[Array, "3 3 I O"]) -> Float[Array, "36 I O"]:
    """G g G^T of every channel pair."""
    matrix = jnp.asarray(KERNEL, kernel.dtype)
    transformed = jnp.einsum("ph,qw,hwio->pqio", matrix, matrix, kernel, precision="highest")
    return transformed.reshape(36, *kernel.shape[2:])


def winograd_conv(
    x: Float[Array, "B H W I"], kernel: Float[Array, "36 I O"], precision: str = "highest"
) -> Float[Array, "B H W O"]:
    """Convolution with stride 1 and a zero border of one pixel.

    Args:
      x: the map.
      kernel: from `winograd_kernel`.
      precision: of the products.
    """
    batch, height, width, channels = x.shape
    rows, columns = -(-height // TILE), -(-width // TILE)
    margin = ((1, TILE * rows + 1 - height), (1, TILE * columns + 1 - width))
    x = jnp.pad(x, ((0, 0), *margin, (0, 0)))
    lines = [lax.slice_in_dim(x, i, i + TILE * (rows - 1) + 1, TILE, axis=1) for i in range(6)]
    tiles = []
    for line in _combine(INPUT, lines):
        points = [lax.slice_in_dim(line, j, j + TILE * (columns - 1) + 1, TILE, axis=2) for j in range(6)]
        tiles += _combine(INPUT, points)
    if batch * rows * columns < SMALL:
        factors = jnp.stack(tiles).reshape(36, -1, channels)
        products = list(jnp.einsum("pni,pio->pno", factors, kernel, precision=precision))
    else:
        products = [
            jnp.dot(t.reshape(-1, channels), k, precision=precision) for t, k in zip(tiles, kernel, strict=True)
        ]
    products = [product.reshape(batch, rows, columns, -1) for product in products]
    lines = _combine(OUTPUT, [jnp.stack(_combine(OUTPUT, products[p : p + 6]), 3) for p in range(0, 36, 6)])
    y = jnp.stack(lines, 2).reshape(batch, TILE * rows, TILE * columns, -1)
    return y[:, :height, :width]


def _combine(matrix: Matrix, parts: list) -> list:
    """The sums of the parts that the rows of a small constant matrix say; a dot would be slower."""
    return [sum(c * part for c, part in zip(row, parts, strict=True) if c != 0) for row in matrix]
