"""Shift-maximised correlation of pairs of maps, each with cells and weights of its own (see `correlation`).

    score(s) = sum_x <A(x + s), B(x)> / sqrt(sum |A(x + s)|^2 sum |B(x)|^2) * overlap(s)^OVERLAP_POWER

Sums run over cells x that B sees and A sees at x + s; overlap is their number over that of the cells of the map that
sees more. So the score of two maps is the same in whatever run they stand.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float, Int, Int8, UInt8

from ebjax.places.correlation import MIN_OVERLAP, OVERLAP_POWER


def _transformed(
    maps: Int8[Array, "n h w D"], weights: UInt8[Array, "n h w"]
) -> tuple[Complex[Array, "n D P Q"], Complex[Array, "n 2 P Q"], Float[Array, "n"]]:
    """Spectra of the weighed maps, of their energy and of what they see, zero-padded; and how many cells they see."""
    size = 2 * maps.shape[1], 2 * maps.shape[2]
    mask = (weights > 0).astype(jnp.float32)
    # Of order 1, so that energies are exact enough in float32.
    values = maps.astype(jnp.float32) * (weights.astype(jnp.float32) / (127 * 255))[..., None]
    planes = jnp.concatenate([jnp.moveaxis(values, -1, 1), jnp.sum(values**2, -1)[:, None], mask[:, None]], 1)
    spectra = jnp.fft.rfft2(planes, size)
    return spectra[:, :-2], spectra[:, -2:], mask.sum((1, 2))


@jax.jit
def correlate_pairs(
    queries: Int8[Array, "W h w D"],
    query_weights: UInt8[Array, "W h w"],
    references: Int8[Array, "K h w D"],
    reference_weights: UInt8[Array, "K h w"],
) -> tuple[Float[Array, "K"], Int[Array, "K 2"]]:
    """The best score in [-1, 1] of each reference, and its shift (rows, columns) in cells.

    query(x + shift) lies on reference(x).

    Args:
      queries: maps of the W ways to see the query: as it is, turned by pi.
      query_weights: of their cells, 0 where nothing is seen.
      references: the first K / W are compared with the first query, and so on.
      reference_weights: of their cells.
    """
    height, width = references.shape[1:3]
    ours, our_planes, our_cells = _transformed(queries, query_weights)
    theirs, their_planes, their_cells = _transformed(references, reference_weights)
    ways, each = len(queries), len(references) // len(queries)
    product = jnp.sum(ours[:, None] * jnp.conj(theirs).reshape(ways, each, *theirs.shape[1:]), 2)
    energy, mask = jnp.moveaxis(jnp.repeat(our_planes, each, 0), 1, 0)
    their_energy, their_mask = jnp.moveaxis(jnp.conj(their_planes), 1, 0)
    planes = [product.reshape(-1, *product.shape[2:]), energy * their_mask, mask * their_energy, mask * their_mask]
    raw, above, below, overlap = jnp.fft.irfft2(jnp.stack(planes), (2 * height, 2 * width))
    share = jnp.round(overlap) / jnp.maximum(jnp.maximum(jnp.repeat(our_cells, each), their_cells), 1)[:, None, None]
    weight = jnp.where(share > MIN_OVERLAP, jnp.maximum(share, 1e-6) ** OVERLAP_POWER, 0)
    score = raw / jnp.sqrt(jnp.maximum(above * below, 1e-8)) * weight
    score = jnp.where(weight > 0, score, -1).reshape(len(references), -1)
    best = jnp.argmax(score, 1).astype(jnp.int32)
    index = jnp.stack([best // (2 * width), best % (2 * width)], -1)
    padded = jnp.array([2 * height, 2 * width], jnp.int32)[None]
    shift = jnp.where(index >= padded // 2, index - padded, index)
    return jnp.take_along_axis(score, best[:, None], 1)[:, 0], shift
