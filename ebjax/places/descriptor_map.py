"""A floor view as a small map of descriptors: rootSIFT at two scales on a grid, projected to the run's own components.

The components are learned from a run's own views, unsupervised: the mean of every grid cell (what all places share:
tile edges, shading, the robot's shadow) is taken away, and a basis of principal directions is kept without whitening.
Every basis vector is even or odd under R_pi, so the map of the view turned by pi is the reversed map times a sign per
channel.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ebjax.geometry.pytree import pytree
from ebjax.models.rootsift import DIMENSION, ROOT_FLOOR, describe, pool_orientations, rotate_pi_descriptor

STRIDE_PX = 8
BIN_PX = (6.0, 12.0)
MIN_SUPPORT = 0.8


@pytree
class MapSpace:
    """The run's components: mean of each cell and scale, basis, parity of each channel under R_pi, cells that count."""

    mean: Float[Array, "h w D0"]
    basis: Float[Array, "D0 D"]
    parity: Float[Array, "D"]
    mask: Float[Array, "h w"]


def grid(size: tuple[int, int]) -> Float[np.ndarray, "h w 2"]:
    """Cell centres (x, y) px, STRIDE_PX apart and symmetric about the view's centre, for a view of (height, width)."""
    axes = []
    for length in (size[1], size[0]):
        cells = max(1, length // STRIDE_PX)
        axes.append((length - 1) / 2 + (np.arange(cells) - (cells - 1) / 2) * STRIDE_PX)
    return np.stack(np.meshgrid(*axes, indexing="xy"), -1).astype(np.float32)


def dense(grey: Float[Array, "H W"], seen: Float[Array, "H W"]) -> tuple[Float[Array, "h w D0"], Float[Array, "h w"]]:
    """Upright rootSIFT at both scales in every cell, and the least share of its support inside the field of view."""
    points = grid((grey.shape[0], grey.shape[1]))
    shape, flat = points.shape[:2], jnp.asarray(points.reshape(-1, 2), grey.dtype)
    values, support = dense_at(grey, seen, flat)
    return values.reshape(*shape, -1), support.reshape(shape)


def dense_at(
    grey: Float[Array, "H W"],
    seen: Float[Array, "H W"],
    points: Float[Array, "N 2"],
    bins_px: tuple[float, ...] = BIN_PX,
    root_floor: float = ROOT_FLOOR,
) -> tuple[Float[Array, "N D0"], Float[Array, "N"]]:
    """As `dense`, at any points (x, y) px; differentiable in the image and in the points.

    Args:
      grey: in [0, 1].
      seen: 1 where the view shows the floor.
      points: px.
      bins_px: side of a spatial bin at every scale, px.
      root_floor: as in `rootsift.root_normalise`.
    """
    described = [describe(pool_orientations(grey, seen, bin_px), points, root_floor) for bin_px in bins_px]
    support = jnp.min(jnp.stack([share for _, share in described]), axis=0)
    return jnp.concatenate([values for values, _ in described], -1), support


def rotate_pi_dense(values: Float[Array, "*n h w D0"]) -> Float[Array, "*n h w D0"]:
    """The dense map of the view turned by pi, exactly: cells reversed, every descriptor turned."""
    return rotate_pi_scales(values)[..., ::-1, ::-1, :]


def rotate_pi_scales(values: Float[Array, "*n D0"]) -> Float[Array, "*n D0"]:
    """The descriptors of the same points, at all scales, in the view turned by pi."""
    scales = values.reshape(*values.shape[:-1], -1, DIMENSION)
    return rotate_pi_descriptor(scales).reshape(values.shape)


def _halves(values: Float[Array, "*n D0"]) -> Float[Array, "2 *n D1"]:
    """Coordinates in the orthonormal even and odd vectors (e_i + turned e_i) / sqrt 2, (e_i - turned e_i) / sqrt 2."""
    scales = values.reshape(*values.shape[:-1], -1, DIMENSION)
    turned = rotate_pi_descriptor(scales)
    both = jnp.stack([scales + turned, scales - turned])[..., : DIMENSION // 2]
    return both.reshape(2, *values.shape[:-1], -1) / np.sqrt(2).astype(values.dtype)


def _whole(coordinates: Float[Array, "n D1"], sign: float) -> Float[Array, "n D0"]:
    """The vectors with such even (sign 1) or odd (-1) coordinates."""
    half = coordinates.reshape(coordinates.shape[0], -1, DIMENSION // 2)
    scales = jnp.concatenate([half, jnp.zeros_like(half)], -1)
    whole = scales + sign * rotate_pi_descriptor(scales)
    return whole.reshape(coordinates.shape[0], -1) / np.sqrt(2).astype(coordinates.dtype)


@partial(jax.jit, static_argnames="channels")
def learn_space(views: Float[Array, "N h w D0"], mask: Bool[Array, "h w"], channels: int) -> MapSpace:
    """Learns the components from a sample of a run's dense maps.

    The covariance, made symmetric under R_pi, has no entries between even and odd vectors: each half is diagonalised by
    itself, which makes parity exact. Computed in float32 at least.
    """
    dtype = jnp.promote_types(views.dtype, jnp.float32)
    count, dimension = mask.astype(dtype), views.shape[-1]

    def add_view(total, view):
        return total + view.astype(dtype), None

    def add_products(total, view):
        rows = ((view.astype(dtype) - mean) * count[..., None]).reshape(-1, dimension)
        return total + rows.T @ rows, None

    mean = jax.lax.scan(add_view, jnp.zeros(views.shape[1:], dtype), views)[0] / len(views)
    products, _ = jax.lax.scan(add_products, jnp.zeros((dimension, dimension), dtype), views)
    blocks = [_halves(half.T)[way] for way, half in enumerate(_halves(products))]
    values, vectors = jnp.linalg.eigh(jnp.stack(blocks) / (len(views) * jnp.maximum(count.sum(), 1)))
    _, order = jax.lax.top_k(values.reshape(-1), channels)
    basis = jnp.concatenate([_whole(vectors[0].T, 1.0), _whole(vectors[1].T, -1.0)])[order]
    parity = jnp.where(order < dimension // 2, 1, -1).astype(dtype)
    return MapSpace(mean, basis.T, parity, count)


def project(view: Float[Array, "h w D0"], space: MapSpace) -> Float[Array, "h w D"]:
    """The centred, projected map; zero in cells that do not count."""
    return ((view - space.mean) @ space.basis) * space.mask[..., None]


def rotate_pi_map(values: Float[Array, "*n h w D"], space: MapSpace) -> Float[Array, "*n h w D"]:
    """The projected map of the view turned by pi: cells reversed, channels times their parity."""
    reversed_cells = values[..., ::-1, ::-1, :]
    return reversed_cells * jnp.broadcast_to(space.parity, values.shape)
