"""floornet as a local feature: Shi-Tomasi corners, described by the network's local map.

A reference seen from the opposite side is not extracted again: its descriptors are those of the view, the odd half with
the other sign. A view of 400 px and more is also described at half its size, and so on, as by `upright`.
"""

from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from ebjax.features.corners import find_corners
from ebjax.features.extractor import Extractor, luma
from ebjax.features.matching import Features
from ebjax.features.upright import CORNERS, RADIUS_PX, halved, octaves
from ebjax.geometry.warp import sample_bilinear
from ebjax.models.fast import Arithmetic
from ebjax.models.floornet import CELL, fitted, open_floornet, parity
from ebjax.models.layers import normalise

STRIDE_PX = CELL // 2


def floornet(weights: Path | None, arithmetic: Arithmetic) -> Extractor:
    """The local feature, with the weights that `open_floornet` finds; it has one arithmetic."""
    path, network = open_floornet(weights)
    graph, state = nnx.split(network)

    # The weights are arguments of one program: as constants in it they would be compiled.
    def extract(view: Float[Array, "H W 3"], seen: Bool[Array, "H W"]) -> Features:
        return _extract(graph, state, jnp.asarray(view), jnp.asarray(seen))

    return Extractor(extract, jitted=False, turn=turn, weights=path)


@partial(jax.jit, static_argnames="graph")
def _extract(graph: Any, state: Any, view: Float[Array, "H W 3"], seen: Bool[Array, "H W"]) -> Features:
    network, grey, found = nnx.merge(graph, state), luma(view).astype(jnp.float32), []
    for octave in range(octaves(*grey.shape)):
        keypoints, _, valid = find_corners(grey, seen, count=CORNERS, radius=RADIUS_PX)
        looked, shown = fitted(grey, seen.astype(jnp.float32))
        maps = network(looked[None], shown[None])
        scale = jnp.array([looked.shape[1] / grey.shape[1], looked.shape[0] / grey.shape[0]], grey.dtype)
        at = (keypoints + 0.5) * scale[None, :] / STRIDE_PX - 0.5
        descriptors = normalise(sample_bilinear(maps.local[0], at))
        found.append(Features((keypoints + 0.5) * 2**octave - 0.5, descriptors, valid))
        grey, seen = halved(grey).mean((1, 3)), halved(seen).all((1, 3))
    return jax.tree.map(lambda *rows: jnp.concatenate(rows), *found)


def turn(descriptors: Float[Array, "*n D"]) -> Float[Array, "*n D"]:
    """The descriptors of the same corners in the view turned by pi."""
    return descriptors * jnp.broadcast_to(
        jnp.asarray(parity(descriptors.shape[-1]), descriptors.dtype), descriptors.shape
    )
