"""A local feature held to so many keypoints a view, to compare several at the same number."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ebjax.features.extractor import Extractor
from ebjax.features.matching import Features


def strongest_only(chosen: Extractor, count: int) -> Extractor:
    """The same local feature, of which only the `count` strongest keypoints of a view are valid.

    Where it finds them in several octaves, the strongest of each octave come first, then the second of each, and so on.
    """

    def extract(view: Float[Array, "H W 3"], seen: Bool[Array, "H W"]) -> Features:
        found = chosen.extract(view, seen)
        octaves = 1 if chosen.octaves is None else chosen.octaves(*view.shape[:2])
        return dataclasses.replace(found, valid=_strongest(found.valid, count, octaves))

    return dataclasses.replace(chosen, extract=extract)


@partial(jax.jit, static_argnames=("count", "octaves"))
def _strongest(valid: Bool[Array, " K"], count: int, octaves: int) -> Bool[Array, " K"]:
    parts = valid.reshape(octaves, -1)
    rank = (jnp.cumsum(parts, 1) - 1) * octaves + jnp.arange(octaves)[:, None]
    rank = jnp.where(parts, rank, valid.size + octaves).reshape(-1)
    # How many valid rows come before each.
    place = jnp.zeros_like(rank).at[jnp.argsort(rank)].set(jnp.arange(valid.size, dtype=rank.dtype))
    return valid & (place < count)
