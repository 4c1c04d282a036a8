"""floornet as a global descriptor: its place map, without what all views of a run share, VLAD with the run's own words.

One look serves both directions: the network is equivariant under R_pi (`models.floornet`).
"""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Bool, Float

from ebjax.models.fast import Arithmetic
from ebjax.models.floornet import fitted, open_floornet, parity
from ebjax.places.descriptor import Descriptor, Places
from ebjax.places.descriptor_map import MIN_SUPPORT, MapSpace
from ebjax.places.rootsift_vlad import global_descriptors, window
from ebjax.places.view import luma


def floornet(weights: Path | None, arithmetic: Arithmetic) -> Descriptor:
    """The descriptor, with the weights that `open_floornet` finds; it has one arithmetic."""
    path, network = open_floornet(weights)
    graph, state = nnx.split(network)

    # The weights are arguments of one program: as constants in it they would be compiled.
    def look(view: Float[Array, "H W 3"], seen: Bool[Array, "H W"], image: Any) -> Mapping[str, Array]:
        return describe_view(graph, state, jnp.asarray(view), jnp.asarray(seen))

    return Descriptor(look, unite, jitted=False, has_maps=True, weights=path)


@partial(jax.jit, static_argnames="graph")
def describe_view(graph: Any, state: Any, view: Float[Array, "H W 3"], seen: Bool[Array, "H W"]) -> Mapping[str, Array]:
    """What is kept of a view, RGB in [0, 1]: its place map, float16, and which of its cells are seen."""
    grey, shown = fitted(luma(view).astype(jnp.float32), seen.astype(jnp.float32))
    places = nnx.merge(graph, state)(grey[None], shown[None]).places[0]
    rows, columns, _ = places.shape
    share = shown.reshape(rows, shown.shape[0] // rows, columns, -1).mean((1, 3))
    return {"map": places.astype(jnp.float16), "cells": share > MIN_SUPPORT}


@jax.jit
def _centre(maps: Float[Array, "N h w D"], cells: Bool[Array, "N h w"]) -> tuple[Array, Array]:
    weight = cells.astype(jnp.float32)[..., None]
    values = maps.astype(jnp.float32)
    mean = jnp.sum(values * weight, 0) / jnp.maximum(jnp.sum(weight, 0), 1)
    return (values - mean[None]) * weight, mean


def unite(kept: Mapping[str, np.ndarray], *, seed: int = 0) -> Places:
    """Maps without the mean of each cell, words, vectors."""
    mask = np.asarray(kept["cells"].any(0))
    rows, columns = window(mask)
    maps, mean = _centre(jnp.asarray(kept["map"][:, rows, columns]), jnp.asarray(kept["cells"][:, rows, columns]))
    dimension = maps.shape[-1]
    counted = jnp.asarray(mask[rows, columns], maps.dtype)
    space = MapSpace(mean, jnp.eye(dimension, dtype=maps.dtype), jnp.asarray(parity(dimension)), counted)
    return Places(global_descriptors(maps, space, seed=seed), maps, space)
