"""Shift-maximised correlation of two descriptor maps: lateral offset and overlap are searched, not averaged away.

    score(s) = sum_x <A(x + s), B(x)> / sqrt(sum |A(x + s)|^2 sum |B(x)|^2) * overlap(s)^OVERLAP_POWER

over the cells x that both views see, for all shifts s at once by FFT; B is the reference map, or that map turned by pi.
The best shift is a first measurement of the loop. Both directions share one spectrum per view: turning by pi conjugates it.
"""

import dataclasses
import typing

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Complex, Float, Int

from ebjax.places.descriptor_map import MapSpace

OVERLAP_POWER = 0.5
MIN_OVERLAP = 0.15


@typing.no_type_check
@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Spectrum:
    """The Fourier transform of a map, zero-padded to twice its size, and its energy in the overlap for every shift.

    `as_query` and `as_reference` hold the energy for the same direction ([..., 0]) and the opposing one ([..., 1]).
    """

    values: Complex[Array, "*n L M D"]
    as_query: Float[Array, "*n P Q 2"]
    as_reference: Float[Array, "*n P Q 2"]


def _padded(size: tuple[int, int]) -> tuple[int, int]:
    return 2 * size[0], 2 * size[1]


def _transform(values: Float[Array, "h w D"]) -> Complex[Array, "L M D"]:
    return jnp.fft.rfft2(values, _padded(values.shape[:2]), axes=(0, 1))


def _both_ways(a: Complex[Array, "L M D"], b: Complex[Array, "L M D"], size: tuple[int, int]) -> Float[Array, "P Q 2"]:
    """Sums over channels of corr(a, b) and corr(a, b reversed), brought to the same shift index (signed, wrapped)."""
    same = jnp.fft.irfft2(jnp.sum(a * jnp.conj(b), -1), _padded(size))
    turned = jnp.fft.irfft2(jnp.sum(a * b, -1), _padded(size))
    turned = jnp.roll(turned, (-(size[0] - 1), -(size[1] - 1)), axis=(0, 1))
    return jnp.stack([same, turned], -1)


def spectrum(values: Float[Array, "h w D"], space: MapSpace) -> Spectrum:
    """What `correlate` needs of a projected map."""
    size = (values.shape[0], values.shape[1])
    mask = _transform(space.mask[..., None])
    energy = _transform(jnp.sum(values**2, -1, keepdims=True))
    return Spectrum(_transform(values), _both_ways(energy, mask, size), _both_ways(mask, energy, size))


def correlate(
    query: Spectrum, reference: Spectrum, opposing: Bool[Array, ""], space: MapSpace
) -> tuple[Float[Array, ""], Int[Array, "2"]]:
    """The best score in [-1, 1] and its shift (rows, columns) in cells: query(x + shift) lies on reference(x)."""
    size = (space.mask.shape[0], space.mask.shape[1])
    rows, columns = size
    way = opposing.astype(jnp.int32)
    other = jnp.where(opposing, reference.values * space.parity, jnp.conj(reference.values))
    raw = jnp.fft.irfft2(jnp.sum(query.values * other, -1), _padded(size))
    origin = jnp.where(opposing, jnp.array([rows - 1, columns - 1], jnp.int32), jnp.zeros(2, jnp.int32))
    raw = jnp.roll(raw, -origin, axis=(0, 1))
    mask = _transform(space.mask[..., None])
    overlap = _both_ways(mask, mask, size)[..., way] / jnp.maximum(jnp.sum(space.mask), 1)
    energy = query.as_query[..., way] * reference.as_reference[..., way]
    score = raw / jnp.sqrt(jnp.maximum(energy, 1e-8)) * jnp.maximum(overlap, 1e-6) ** OVERLAP_POWER
    score = jnp.where(overlap > MIN_OVERLAP, score, -1.0)
    best = jnp.argmax(score)
    index = jnp.stack([best // score.shape[1], best % score.shape[1]]).astype(jnp.int32)
    padded = jnp.array(_padded(size), jnp.int32)
    shift = jnp.where(index >= padded // 2, index - padded, index)
    return score.reshape(-1)[best], shift
