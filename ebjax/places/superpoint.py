"""SuperPoint's dense descriptors, aggregated by VLAD with words from the run's own cells in both orientations."""

from collections.abc import Mapping
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ebjax.models.fast import Arithmetic
from ebjax.models.luma import luma
from ebjax.models.superpoint import SuperPoint
from ebjax.places.descriptor import Descriptor, Places
from ebjax.places.network import network_descriptor
from ebjax.places.view import cells_seen
from ebjax.places.vlad import Vocabulary, centred, vlad
from ebjax.places.words import SAMPLE_CELLS, words_of

SIDE_PX = 200


def read(network: SuperPoint, images: Float[Array, "2 H W 3"], shown: Float[Array, "2 H W"]) -> dict[str, Array]:
    """A unit descriptor every 8 px, float16, and whether its cell is seen."""
    _, dense = network(luma(images)[..., None])
    return {"map": dense.astype(jnp.float16), "cells": cells_seen(shown, dense.shape[1:3])}


@jax.jit
def _aggregate(maps: Float[Array, "N 2 P D"], cells: Bool[Array, "N 2 P"], words: Vocabulary) -> Float[Array, "N V 2"]:
    def both(one):
        values, weight = (leaf.astype(words.centres.dtype) for leaf in one)
        return jnp.stack([vlad(values[way], weight[way], words) for way in (0, 1)], -1)

    return centred(jax.lax.map(both, (maps, cells)))


def unite(kept: Mapping[str, np.ndarray], *, seed: int = 0) -> Places:
    """Words, then vectors.

    Raises:
      ValueError: no cell is seen in any view.
    """
    maps = kept["map"].reshape(*kept["map"].shape[:2], -1, kept["map"].shape[-1])
    cells = kept["cells"].reshape(maps.shape[:3])
    seen = np.flatnonzero(cells)
    if not len(seen):
        raise ValueError("no cell of the view is seen well enough to be described; look at more floor")
    chosen = np.random.default_rng(seed).choice(seen, min(len(seen), SAMPLE_CELLS), replace=False)
    words = words_of(maps.reshape(-1, maps.shape[-1])[chosen].astype(np.float32), seed=seed)
    return Places(_aggregate(maps, cells, words))


def superpoint(weights: Path | None, arithmetic: Arithmetic) -> Descriptor:
    """Of Magic Leap's weights, or v6."""
    return network_descriptor(
        "superpoint", weights, arithmetic, read, unite, side_px=SIDE_PX, accepted=("superpoint-v6",)
    )
