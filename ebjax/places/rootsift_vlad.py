"""The default descriptor: dense upright rootSIFT, projected to the run's own components, VLAD with the run's own words.

It needs no weights. The view turned by pi is not looked at again: components are even or odd under R_pi, so its map is
known exactly (`descriptor_map`). The maps are kept, for shift-maximised correlation ranks better than any one vector.
Cells whose descriptors reach beyond what is seen do not count.
"""

from collections.abc import Mapping
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, UInt8

from ebjax.places.descriptor import Descriptor, Places
from ebjax.places.descriptor_map import MIN_SUPPORT, MapSpace, dense, learn_space, project
from ebjax.places.view import luma
from ebjax.places.vlad import centred, kmeans, vlad

CHANNELS = 32
CLUSTERS = 32
SAMPLE_VIEWS = 256
SAMPLE_CELLS = 30_000
BLOCK = 32


def look(view: Float[Array, "H W 3"], seen: Bool[Array, "H W"], image: UInt8[ArrayLike, "I J 3"]) -> dict[str, Array]:
    """The dense map, float16, and which of its cells are described from what is seen alone."""
    place_map, support = dense(luma(view), seen.astype(view.dtype))
    return {"map": place_map.astype(jnp.float16), "cells": support > MIN_SUPPORT}


def window(mask: Bool[np.ndarray, "r c"]) -> tuple[slice, slice]:
    """The smallest part of the grid, symmetric about its centre, that holds all cells that count.

    Raises:
      ValueError: none counts.
    """
    if not mask.any():
        raise ValueError("no cell of the view is seen well enough to be described; look at more floor")
    slices = []
    for axis in (1, 0):
        used = np.asarray(mask.any(axis))
        border = int(min(np.argmax(used), np.argmax(used[::-1])))
        slices.append(slice(border, len(used) - border))
    return slices[0], slices[1]


@jax.jit
def _project_block(block: Float[Array, "B r c D0"], space: MapSpace) -> Float[Array, "B r c D"]:
    return jax.vmap(lambda one: project(one.astype(space.mean.dtype), space))(block)


def project_all(
    dense_maps: Float[np.ndarray, "N r c D0"], cells: Bool[np.ndarray, "N r c"]
) -> tuple[Float[Array, "N h w D"], MapSpace]:
    """Learns the components from a sample of the views and projects all of them; what is not seen becomes zero.

    Args:
      dense_maps: from `descriptor_map.dense`, one a view.
      cells: which cells of each view count.

    Raises:
      ValueError: no cell counts in any view.
    """
    views, mask = len(dense_maps), np.asarray(cells.any(0))
    rows, columns = window(mask)
    cut = dense_maps[:, rows, columns]
    sample = np.unique(np.linspace(0, views - 1, min(views, SAMPLE_VIEWS)).round().astype(int))
    space = learn_space(cut[sample], mask[rows, columns], CHANNELS)
    blocks = [np.asarray(_project_block(cut[np.arange(k, k + BLOCK) % views], space)) for k in range(0, views, BLOCK)]
    maps = jnp.asarray(np.concatenate(blocks)[:views])
    return maps * jnp.asarray(cells[:, rows, columns, None], maps.dtype), space


@partial(jax.jit, static_argnames="seed")
def vocabulary(words: Float[Array, "M D"], *, seed: int) -> Float[Array, "K D"]:
    """CLUSTERS words."""
    return kmeans(words, clusters=CLUSTERS, key=jax.random.key(seed))


@jax.jit
def _describe(maps: Float[Array, "N r c D"], centres: Float[Array, "K D"], space: MapSpace) -> Float[Array, "N V 2"]:
    weight = space.mask.reshape(-1)

    def both(values):
        cells = values.reshape(-1, values.shape[-1])  # sums over cells do not see that turning reverses their order
        return jnp.stack([vlad(side, weight, centres) for side in (cells, cells * space.parity[None, :])], -1)

    return centred(jax.lax.map(both, maps))


def global_descriptors(maps: Float[Array, "N r c D"], space: MapSpace, *, seed: int = 0) -> Float[Array, "N V 2"]:
    """VLAD of every view as it is ([..., 0], the query and same-direction reference) and turned by pi ([..., 1]).

    The vocabulary comes from the run's own cells, in both orientations. The mean over the run is taken away, as it is
    from the maps: it is what all places share.
    """
    host = np.asarray(maps).reshape(len(maps), -1, maps.shape[-1])
    cells = np.flatnonzero(np.asarray(space.mask))
    total = len(host) * len(cells)
    chosen = np.random.default_rng(seed).choice(total, min(total, SAMPLE_CELLS // 2), replace=False)
    rows = host[chosen // len(cells), cells[chosen % len(cells)]]
    words = np.concatenate([rows, rows * np.asarray(space.parity)[None, :]])
    return _describe(maps, vocabulary(words, seed=seed), space)


def unite(kept: Mapping[str, np.ndarray], *, seed: int = 0) -> Places:
    """Components, words, vectors."""
    maps, space = project_all(kept["map"], kept["cells"])
    return Places(global_descriptors(maps, space, seed=seed), maps, space)


ROOTSIFT_VLAD = Descriptor(look, unite, has_maps=True)
