"""The last map of a classification network, flattened and reduced by PCA (Early Bird, section III-B), or its mean.

The flattened map keeps where on the floor something lies ("viewpoint-presumed": R_pi has aligned the views); the mean
over it does not. Cells that are not seen take the run's mean, so they say nothing. Components are learned from the
run's own views in both orientations, and not whitened.
"""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ebjax.places.descriptor import Places
from ebjax.places.view import cells_seen, unit

SIDE_PX = 224
"""What these networks were trained at: a map of 7 x 7 cells."""
COMPONENTS = 256
SAMPLE_VIEWS = 256
BLOCK = 32


def flat(values: Float[Array, "2 h w C"], shown: Float[Array, "2 H W"]) -> dict[str, Array]:
    """What is kept of a map: itself, with a root mean square of 1, float16; and the cells that are seen."""
    cells = cells_seen(shown, values.shape[1:3])
    weight = cells[..., None].astype(values.dtype)
    power = jnp.sum(values**2 * weight) / jnp.maximum(jnp.sum(weight) * values.shape[-1], 1)
    scaled = values / jnp.sqrt(jnp.maximum(power, 1e-12))
    return {"map": scaled.astype(jnp.float16), "cells": cells}


def pooled(values: Float[Array, "2 h w C"], shown: Float[Array, "2 H W"]) -> dict[str, Array]:
    """What is kept of a map: its mean over the cells that are seen, as a map of one cell."""
    weight = cells_seen(shown, values.shape[1:3])[..., None].astype(values.dtype)
    mean = jnp.sum(values * weight, (1, 2), keepdims=True) / jnp.maximum(jnp.sum(weight, (1, 2), keepdims=True), 1)
    return flat(mean, jnp.ones_like(shown))


@jax.jit
def principal_directions(rows: Float[Array, "M F"]) -> Float[Array, "F K"]:
    """The directions of largest variance of rows whose mean is zero, at most COMPONENTS, by the M x M Gram matrix.

    Directions without variance are zero.
    """
    count = min(COMPONENTS, *rows.shape)
    values, vectors = jnp.linalg.eigh(jnp.matmul(rows, rows.T, precision="highest"))
    values, vectors = values[::-1][:count], vectors[:, ::-1][:, :count]
    scale = jnp.where(values > 1e-6 * values[0], 1 / jnp.sqrt(jnp.maximum(values, 1e-30)), 0)
    return jnp.matmul(rows.T, vectors, precision="highest") * scale[None, :]


@jax.jit
def _centre(block: Float[Array, "B 2 h w C"], cells: Float[Array, "B 2 h w"], mean: Float[Array, "2 h w C"]):
    return ((block.astype(mean.dtype) - mean[None]) * cells[..., None]).reshape(2 * len(block), -1)


_project = jax.jit(lambda rows, basis: unit(jnp.matmul(rows, basis, precision="highest")))


def unite(kept: Mapping[str, np.ndarray], *, seed: int = 0) -> Places:
    """Centres every cell in each orientation, learns the components, projects."""
    maps, cells = kept["map"], kept["cells"].astype(np.float32)
    total, count = (np.zeros(shape, np.float32) for shape in (maps.shape[1:], cells.shape[1:]))
    for one, shown in zip(maps, cells, strict=True):
        total += one * shown[..., None]
        count += shown
    mean = jnp.asarray(total / np.maximum(count, 1)[..., None])
    sample = np.unique(np.linspace(0, len(maps) - 1, min(len(maps), SAMPLE_VIEWS)).round().astype(int))
    basis = principal_directions(_centre(maps[sample], cells[sample], mean))
    vectors = []
    for start in range(0, len(maps), BLOCK):
        rows = np.arange(start, start + BLOCK) % len(maps)  # the last block is filled up: one shape
        projected = np.asarray(_project(_centre(maps[rows], cells[rows], mean), basis))
        vectors.append(projected.reshape(BLOCK, 2, -1))
    return Places(jnp.asarray(np.concatenate(vectors)[: len(maps)].transpose(0, 2, 1)))
