"""Shift-maximised correlation of pairs of maps, each with cells and weights of its own (see `correlation`).

    score(s) = sum_x <A(x + s), B(x)> / sqrt(sum |A(x + s)|^2 sum |B(x)|^2) * overlap(s)^OVERLAP_POWER

Sums run over cells x that B sees and A sees at x + s; overlap is their number over that of the cells of the map that
sees more. So the score of two maps is the same in whatever run they stand.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float, Int, Int8, UInt8

from ebjax.geometry.pytree import pytree
from ebjax.places.correlation import MIN_OVERLAP, OVERLAP_POWER


@pytree
class Spectra:
    """Maps, zero-padded to twice their size and transformed: what is correlated, their energy, what they see.

    `cells` says how many cells they see.
    """

    values: Complex[Array, "*n D P Q"]
    planes: Complex[Array, "*n 2 P Q"]
    cells: Float[Array, "*n"]


@jax.jit
def spectrum(values: Int8[Array, "h w D"], weights: UInt8[Array, "h w"]) -> Spectra:
    """Of one map, whatever others there are: its bits depend on nothing else.

    Args:
      values: of the cells.
      weights: of the cells, 0 where nothing is seen.
    """
    mask = (weights > 0).astype(jnp.float32)
    # Of order 1, so that energies are exact enough in float32.
    weighed = values.astype(jnp.float32) * (weights.astype(jnp.float32) / (127 * 255))[..., None]
    planes = jnp.concatenate([jnp.moveaxis(weighed, -1, 0), jnp.sum(weighed**2, -1)[None], mask[None]])
    spectra = jnp.fft.rfft2(planes, (2 * values.shape[0], 2 * values.shape[1]))
    return Spectra(spectra[:-2], spectra[-2:], mask.sum())


@jax.jit
def correlate_rows(
    straight: Spectra, turned: Spectra, held: Spectra, rows: Int[Array, "2 K"]
) -> tuple[Float[Array, "2 K"], Int[Array, "2 K 2"]]:
    """The best score in [-1, 1] of each reference, and its shift (rows, columns) in cells.

    query(x + shift) lies on reference(x).

    Args:
      straight: of the query.
      turned: of the query turned by pi.
      held: of references.
      rows: which of them are compared with the query as it is, and which with the query turned.
    """
    theirs = jax.tree.map(lambda leaf: leaf[rows], held)
    ours = jax.tree.map(lambda *leaves: jnp.stack(leaves), straight, turned)
    padded = 2 * (ours.values.shape[-1] - 1)
    height, width = ours.values.shape[-2], padded
    product = jnp.sum(ours.values[:, None] * jnp.conj(theirs.values), 2)
    energy, mask = jnp.moveaxis(ours.planes[:, None], 2, 0)
    their_energy, their_mask = jnp.moveaxis(jnp.conj(theirs.planes), 2, 0)
    planes = [product, energy * their_mask, mask * their_energy, mask * their_mask]
    raw, above, below, overlap = jnp.fft.irfft2(jnp.stack(planes), (height, width))
    most = jnp.maximum(jnp.maximum(ours.cells[:, None], theirs.cells), 1)
    share = jnp.round(overlap) / most[..., None, None]
    weight = jnp.where(share > MIN_OVERLAP, jnp.maximum(share, 1e-6) ** OVERLAP_POWER, 0)
    score = raw / jnp.sqrt(jnp.maximum(above * below, 1e-8)) * weight
    score = jnp.where(weight > 0, score, -1).reshape(*rows.shape, -1)
    best = jnp.argmax(score, -1).astype(jnp.int32)
    index = jnp.stack([best // width, best % width], -1)
    size = jnp.broadcast_to(jnp.array([height, width], jnp.int32), index.shape)
    shift = jnp.where(index >= size // 2, index - size, index)
    return jnp.take_along_axis(score, best[..., None], -1)[..., 0], shift
