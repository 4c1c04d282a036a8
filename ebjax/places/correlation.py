"""Shift-maximised correlation of two descriptor maps: lateral offset and overlap are searched, not averaged away.

    score(s) = sum_x <A(x + s), B(x)> / sqrt(sum |A(x + s)|^2 sum |B(x)|^2) * overlap(s)^OVERLAP_POWER

over the cells x that both views see, for all shifts s at once by FFT; B is the reference map, or that map turned by pi.
The best shift is a first measurement of the loop. Both directions share a spectrum: turning by pi conjugates it.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float, Int

from ebjax.geometry.pytree import pytree
from ebjax.places.descriptor_map import MapSpace

OVERLAP_POWER = 0.5
MIN_OVERLAP = 0.15


@pytree
class Spectrum:
    """The Fourier transform of a map, zero-padded to twice its size, and its energy in the overlap for every shift.

    `values` has the real parts of all channels, then the imaginary ones: sums over channels are real matrix products.
    `as_query` and `as_reference` hold the energy for the same direction ([..., 0]) and the opposing one ([..., 1]).
    """

    values: Float[Array, "*n F D2"]
    as_query: Float[Array, "*n P Q 2"]
    as_reference: Float[Array, "*n P Q 2"]


def _padded(size: tuple[int, ...]) -> tuple[int, int]:
    return 2 * size[0], 2 * size[1]


def _transform(values: Float[Array, "h w D"]) -> Complex[Array, "L M D"]:
    return jnp.fft.rfft2(values, _padded(values.shape), axes=(0, 1))


def _to_shifts(spectrum: Complex[Array, "*n L M"], size: tuple[int, ...], *, opposing: bool) -> Float[Array, "*n P Q"]:
    """Back from frequencies to shifts, signed and wrapped; unconjugated products correlate with the reversed map."""
    values = jnp.fft.irfft2(spectrum, _padded(size))
    return jnp.roll(values, (1 - size[0], 1 - size[1]), axis=(-2, -1)) if opposing else values


def _both_ways(a: Complex[Array, "L M 1"], b: Complex[Array, "L M 1"], size: tuple[int, ...]) -> Float[Array, "P Q 2"]:
    same = _to_shifts((a * jnp.conj(b))[..., 0], size, opposing=False)
    return jnp.stack([same, _to_shifts((a * b)[..., 0], size, opposing=True)], -1)


def spectrum(values: Float[Array, "h w D"], space: MapSpace) -> Spectrum:
    """What `correlate` needs of a projected map."""
    size = space.mask.shape
    mask = _transform(space.mask[..., None])
    energy = _transform(jnp.sum(values**2, -1, keepdims=True))
    transformed = _transform(values).reshape(-1, values.shape[-1])
    parts = jnp.concatenate([transformed.real, transformed.imag], -1)
    return Spectrum(parts, _both_ways(energy, mask, size), _both_ways(mask, energy, size))


def overlap_weight(space: MapSpace) -> Float[Array, "P Q 2"]:
    """overlap(s)^OVERLAP_POWER for both directions, 0 where less than MIN_OVERLAP of the cells overlap."""
    mask = _transform(space.mask[..., None])
    overlap = _both_ways(mask, mask, space.mask.shape) / jnp.maximum(jnp.sum(space.mask), 1)
    return jnp.where(overlap > MIN_OVERLAP, jnp.maximum(overlap, 1e-6) ** OVERLAP_POWER, 0)


def correlate(
    query: Spectrum, references: Spectrum, weight: Float[Array, "P Q 2"], space: MapSpace, *, opposing: bool
) -> tuple[Float[Array, "k"], Int[Array, "k 2"]]:
    """The best score in [-1, 1] of one query with each of k references, and its shift (rows, columns) in cells.

    query(x + shift) lies on reference(x). Rows of a floor view run backwards and columns to the right, so the query's
    view lies `shift` cells of STRIDE_PX ahead and to the left of the reference's, in the query's own heading; an
    opposing reference is turned about the centre of its view.

    Args:
      query: from `spectrum`.
      references: from `spectrum`, stacked.
      weight: from `overlap_weight`.
      space: of all maps.
      opposing: whether the references are turned by pi.
    """
    size, way = space.mask.shape, int(opposing)
    real, imaginary = jnp.split(query.values, 2, -1)
    if opposing:
        real, imaginary = real * space.parity[None, :], imaginary * space.parity[None, :]
        products = (real, -imaginary), (imaginary, real)
    else:
        products = (real, imaginary), (imaginary, -real)
    ours = jnp.stack([jnp.concatenate(parts, -1) for parts in products], 1)
    summed = jnp.einsum("kfd,fcd->kfc", references.values, ours)
    height, width = _padded(size)
    frequencies = jax.lax.complex(summed[..., 0], summed[..., 1]).reshape(-1, height, width // 2 + 1)
    raw = _to_shifts(frequencies, size, opposing=opposing)
    energy = query.as_query[None, ..., way] * references.as_reference[..., way]
    weight = weight[None, ..., way]
    score = jnp.where(weight > 0, raw / jnp.sqrt(jnp.maximum(energy, 1e-8)) * weight, -1).reshape(len(raw), -1)
    best = jnp.argmax(score, 1).astype(jnp.int32)
    index = jnp.stack([best // width, best % width], -1)
    padded = jnp.array([height, width], jnp.int32)[None, :]
    shift = jnp.where(index >= padded // 2, index - padded, index)
    return jnp.take_along_axis(score, best[:, None], 1)[:, 0], shift
