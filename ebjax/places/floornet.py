"""floornet as a global descriptor: its place map, without what all views of a run share, VLAD with the run's own words.

One look serves both directions: the network is equivariant under R_pi (`models.floornet`).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ebjax.models.eye import Looked, open_eye
from ebjax.models.fast import Arithmetic
from ebjax.models.floornet import parity
from ebjax.places.descriptor import Descriptor, Places
from ebjax.places.descriptor_map import MIN_SUPPORT, MapSpace
from ebjax.places.rootsift_vlad import window
from ebjax.places.words import by_words


def floornet(weights: Path | None, arithmetic: Arithmetic) -> Descriptor:
    """The descriptor, with the weights that `open_floornet` finds; it has one arithmetic."""
    eye = open_eye(weights)

    def look(view: Float[Array, "H W 3"], seen: Bool[Array, "H W"], image: Any) -> Mapping[str, Array]:
        return keep(eye(view, seen))

    return Descriptor(look, unite, jitted=False, has_maps=True, weights=eye.path)


@jax.jit
def keep(looked: Looked) -> Mapping[str, Array]:
    """What is kept of a view: its place map, float16, and which of its cells are seen."""
    rows, columns, _ = looked.places.shape
    share = looked.shown.reshape(rows, looked.shown.shape[0] // rows, columns, -1).mean((1, 3))
    return {"map": looked.places.astype(jnp.float16), "cells": share > MIN_SUPPORT}


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
    vectors, weighed = by_words(maps, space, seed=seed)
    return Places(vectors, weighed, space)
