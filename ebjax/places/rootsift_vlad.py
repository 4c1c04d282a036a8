"""The default descriptor: dense upright rootSIFT, projected to the run's own components, VLAD with the run's own words.

It needs no weights. The view turned by pi is not looked at again: components are even or odd under R_pi, so its map is
known exactly (`descriptor_map`). The maps are kept, for shift-maximised correlation ranks better than any one vector.
Cells whose descriptors reach beyond what is seen do not count.
"""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, UInt8

from ebjax.models.luma import luma
from ebjax.places.descriptor import Descriptor, Places
from ebjax.places.descriptor_map import MIN_SUPPORT, MapSpace, dense, learn_space, project
from ebjax.places.words import by_words

CHANNELS = 32
SAMPLE_VIEWS = 256
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


def unite(kept: Mapping[str, np.ndarray], *, seed: int = 0) -> Places:
    """Components, words, vectors."""
    maps, space = project_all(kept["map"], kept["cells"])
    vectors, weighed = by_words(maps, space, seed=seed)
    return Places(vectors, weighed, space)


ROOTSIFT_VLAD = Descriptor(look, unite, has_maps=True)
