"""The place of one view, made of that view alone: what an index of places is asked with and what it holds.

    place = placing("floornet")(kept)        kept: what the descriptor's `look` gives

Places are host arrays of eight bits, so that what was read from a file is what was written. Their scale says nothing:
vectors are compared by their cosine, maps by their correlation. The program looks at one view at a time, so its bits
never depend on other views.
"""

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int8, UInt8

from ebjax.parts import is_own
from ebjax.places.descriptor import DESCRIPTORS
from ebjax.places.fixed_words import FixedWords, fixed_words
from ebjax.places.hog import rotate_pi_blocks
from ebjax.places.vlad import Vocabulary, aggregate, shares

WITHOUT = ("superpoint",)
"""Descriptors whose words come from the run: no view has a place of its own."""


class Place(NamedTuple):
    """What a view is told apart by.

    `vector` is of the view as it is, `turned` of the view turned by pi. `map` and `weight` are there where maps can be
    correlated: a descriptor in every cell, `scale * map`, and how much the cell counts, 0 where it is not seen.
    """

    vector: Int8[np.ndarray, "V"]
    turned: Int8[np.ndarray, "V"]
    map: Int8[np.ndarray, "h w D"] | None = None
    weight: UInt8[np.ndarray, "h w"] | None = None
    scale: float = 1.0


Kept = Mapping[str, np.ndarray]


@functools.cache
def placing(name: str, weights: Path | None = None) -> Callable[[Kept], Place]:
    """What makes a place of what the descriptor of this name keeps of a view: words of ours, or vectors of its own.

    Raises:
      ValueError: no such descriptor, or no place can be made of one view; as `fixed_words`.
      OSError: as `fixed_words`.
    """
    if is_own(name):
        return functools.partial(_vectors, name)
    if name not in DESCRIPTORS or name in WITHOUT:
        able = ", ".join(one for one in DESCRIPTORS if one not in WITHOUT)
        raise ValueError(f"descriptor {name!r} makes no place of one view; these do: {able}")
    if name in ("floornet", "rootsift-vlad"):
        return functools.partial(place_of, words=fixed_words(name, weights))
    if name == "joint":
        both = fixed_words("floornet", weights), fixed_words("rootsift-vlad")
        return functools.partial(_joint, words=both)
    return {"hog": _hog, "netvlad": _netvlad}.get(name, _flattened)


def place_of(kept: Kept, words: FixedWords) -> Place:
    """The place of one view by fixed words: VLAD, and its map with every cell weighed by how rare its words are in it.

    Args:
      kept: "map" and "cells" of the view, as the descriptor's `look` gives them.
      words: of that descriptor.

    Raises:
      ValueError: the map is not one that these words were learned from.
    """
    vector, values, weight, scale = _described(kept, words)
    straight = quantised(vector)
    return Place(straight, turned(straight, words), values, weight, scale)


def turned(vectors: Int8[np.ndarray, "*n V"], words: FixedWords) -> Int8[np.ndarray, "*n V"]:
    """The vectors of the views turned by pi: every word changes places with its mirror image, odd channels their sign.

    Args:
      vectors: from `place_of`.
      words: that they were made by.
    """
    parity = np.asarray(words.parity, np.int8)
    halves = vectors.reshape(*vectors.shape[:-1], 2, -1, len(parity))
    return (halves[..., ::-1, :, :] * parity).reshape(vectors.shape)


def turned_map(values: Int8[np.ndarray, "h w D"], words: FixedWords) -> Int8[np.ndarray, "h w D"]:
    """The map of the view turned by pi."""
    return values[::-1, ::-1] * np.asarray(words.parity, np.int8)


def quantised(vector: Float[np.ndarray, "V"]) -> Int8[np.ndarray, "V"]:
    """In eight bits, the largest value 127."""
    return np.round(vector * (127 / max(float(np.abs(vector).max()), 1e-9))).astype(np.int8)


def _described(kept: Kept, words: FixedWords):
    channels, needed = kept["map"].shape[-1], words.mean.shape[0]
    if channels != needed:
        raise ValueError(f"maps of {channels} channels: the words of {words.name} were learned from {needed}")
    vector, values, weight, scale = _describe(kept["map"], kept["cells"], words)
    return np.asarray(vector), np.asarray(values), np.asarray(weight), float(scale)


@jax.jit
def _describe(
    values: Float[Array, "h w D0"], cells: Bool[Array, "h w"], words: FixedWords
) -> tuple[Float[Array, "V"], Int8[Array, "h w D"], UInt8[Array, "h w"], Float[Array, ""]]:
    seen = cells.reshape(-1).astype(jnp.float32)
    rows = values.reshape(-1, values.shape[-1]).astype(jnp.float32) - words.mean[None]
    rows = (rows @ words.basis) * seen[:, None]
    vocabulary = Vocabulary(jnp.concatenate([words.words, words.words * words.parity[None]]), words.alpha)
    share = shares(rows, seen, vocabulary)
    # n cells of one word weigh as sqrt(n), see `words`; the words of the turned view are their mirror images.
    weight = share @ (1 / jnp.sqrt(1 + share.sum(0)))
    weight = jnp.where(cells.reshape(-1), jnp.clip(jnp.round(255 * weight / jnp.max(weight)), 1, 255), 0)
    scale = jnp.maximum(jnp.max(jnp.abs(rows)), 1e-9) / 127
    small = jnp.round(rows / scale).astype(jnp.int8)
    shape = cells.shape
    vector = aggregate(rows, share, vocabulary.centres)
    return vector, small.reshape(*shape, -1), weight.astype(jnp.uint8).reshape(shape), scale


def _vectors(name: str, kept: Kept) -> Place:
    if missing := [key for key in ("vector", "turned") if key not in kept]:
        raise ValueError(
            f"descriptor {name!r}: look gives {', '.join(kept)} and no {missing[0]!r}; give 'vector' and 'turned', of "
            "the view as it is and turned by pi: a map knows places one by one"
        )
    vector, other = (quantised(np.asarray(kept[key], np.float32).reshape(-1)) for key in ("vector", "turned"))
    return Place(vector, other)


def _joint(kept: Kept, words: tuple[FixedWords, FixedWords]) -> Place:
    """Floor and whole image, each half of the cosine; of the turned view the image has no part, as in `joint`."""
    floor, image = (
        _described({key: kept[f"{part}_{key}"] for key in ("map", "cells")}, by)
        for part, by in zip(("floor", "whole"), words, strict=True)
    )
    # One scale for both, so that the floor's part is the same as it is and turned.
    straight = quantised(np.concatenate([floor[0], image[0]]))
    other = np.concatenate([turned(straight[: len(floor[0])], words[0]), np.zeros(len(image[0]), np.int8)])
    return Place(straight, other, *floor[1:])


def _hog(kept: Kept) -> Place:
    blocks = np.asarray(kept["blocks"], np.float32)
    other = np.asarray(rotate_pi_blocks(jnp.asarray(blocks)))
    return Place(quantised(blocks.reshape(-1)), quantised(other.reshape(-1)))


def _netvlad(kept: Kept) -> Place:
    straight, other = np.asarray(kept["vectors"], np.float32)
    return Place(quantised(straight), quantised(other))


def _flattened(kept: Kept) -> Place:
    straight, other = kept["map"].astype(np.float32) * kept["cells"][..., None]
    return Place(quantised(straight.reshape(-1)), quantised(other.reshape(-1)))
