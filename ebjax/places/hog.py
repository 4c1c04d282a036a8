"""Histograms of oriented gradients (Dalal and Triggs, CVPR 2005) of a whole view, without weights.

Nine unsigned orientations, votes shared between neighbouring orientations and cells, blocks of 2 x 2 cells brought to
unit length, clipped at 0.2 and again. Where a block is less than half seen it is zero. The view turned by pi is the
same blocks in reversed order: unsigned orientations do not change.
"""

import math
from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, UInt8

from ebjax.models.luma import luma
from ebjax.places.descriptor import Descriptor, Places
from ebjax.places.view import MIN_SHARE
from ebjax.places.vlad import centred

CELL_PX = 16
ORIENTATIONS = 9
CLIP = 0.2


def _pooling(length: int) -> np.ndarray:
    """Bilinear shares of every pixel in the whole cells of a side, which lie symmetric about its centre."""
    cells = max(2, length // CELL_PX)
    centres = (length - 1) / 2 + (np.arange(cells) - (cells - 1) / 2) * CELL_PX
    return np.maximum(0, 1 - np.abs(centres[:, None] - np.arange(length)[None, :]) / CELL_PX).astype(np.float32)


def histograms(grey: Float[Array, "H W"], seen: Float[Array, "H W"]) -> Float[Array, "r c 10"]:
    """Gradients by orientation, pooled in cells; the last channel is the share of the cell that is seen.

    A gradient counts where both neighbours of its pixel are seen along both axes.
    """

    def differences(values):
        return jnp.pad(values[1:-1, 2:] - values[1:-1, :-2], 1), jnp.pad(values[2:, 1:-1] - values[:-2, 1:-1], 1)

    inside = seen[1:-1, 2:] * seen[1:-1, :-2] * seen[2:, 1:-1] * seen[:-2, 1:-1]
    weight = jnp.pad(inside, 1)
    gx, gy = differences(grey)
    squared = gx * gx + gy * gy
    some = squared > 0
    magnitude = jnp.where(some, jnp.sqrt(jnp.where(some, squared, 1)), 0) * weight
    turn = jnp.arctan2(gy, jnp.where(some, gx, 1)) * (ORIENTATIONS / math.pi)
    apart = jnp.mod(turn[..., None] - jnp.arange(ORIENTATIONS, dtype=grey.dtype)[None, None, :], ORIENTATIONS)
    votes = jnp.maximum(0, 1 - jnp.minimum(apart, ORIENTATIONS - apart)) * magnitude[..., None]
    channels = jnp.concatenate([votes, weight[..., None]], -1)
    rows, columns = (jnp.asarray(_pooling(length), grey.dtype) for length in grey.shape)
    pooled = jnp.einsum("rh,hwk,cw->rck", rows, channels, columns)
    return pooled.at[..., -1].divide(CELL_PX**2)


def blocks(cells: Float[Array, "r c 10"]) -> Float[Array, "s d 36"]:
    """Blocks of 2 x 2 cells, L2-Hys; zero where less than half is seen."""
    around = [cells[y : y - 1 or None, x : x - 1 or None] for y in (0, 1) for x in (0, 1)]
    values = jnp.concatenate([cell[..., :-1] for cell in around], -1)
    shown = sum(cell[..., -1:] for cell in around) / 4 >= MIN_SHARE
    tiny = jnp.asarray(1e-6, values.dtype)
    for limit in (CLIP, jnp.inf):
        values = jnp.minimum(values / jnp.sqrt(jnp.sum(values**2, -1, keepdims=True) + tiny), limit)
    return values * shown


def rotate_pi_blocks(values: Float[Array, "*n s d 36"]) -> Float[Array, "*n s d 36"]:
    """The blocks of the view turned by pi."""
    cells = values.reshape(*values.shape[:-1], 4, ORIENTATIONS)
    return cells[..., ::-1, ::-1, ::-1, :].reshape(values.shape)


def look(view: Float[Array, "H W 3"], seen: Bool[Array, "H W"], image: UInt8[ArrayLike, "I J 3"]) -> dict[str, Array]:
    """The blocks."""
    return {"blocks": blocks(histograms(luma(view), seen.astype(view.dtype)))}


def unite(kept: Mapping[str, np.ndarray], *, seed: int = 0) -> Places:
    """All blocks of a view as one vector, less the mean over the run."""
    straight = jnp.asarray(kept["blocks"])
    ways = [values.reshape(len(values), -1) for values in (straight, rotate_pi_blocks(straight))]
    return Places(centred(jnp.stack(ways, -1)))


HOG = Descriptor(look, unite)
