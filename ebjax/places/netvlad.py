"""NetVLAD as published: its own words and whitening, nothing learned from the run.

Cells of the map that are less than half seen take no part in the sums.
"""

from collections.abc import Mapping
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ebjax.models.fast import Arithmetic
from ebjax.models.layers import normalise
from ebjax.models.netvlad import NetVLAD
from ebjax.places.descriptor import Descriptor, Places
from ebjax.places.network import network_descriptor
from ebjax.places.view import cells_seen

SIDE_PX = 400
LAYER = "conv5_3"


def read(network: NetVLAD, images: Float[Array, "2 H W 3"], shown: Float[Array, "2 H W"]) -> dict[str, Array]:
    """`network(images)`, with the soft assignment of what is not seen set to zero."""
    maps = network.backbone.taps(network.preprocess(images), (LAYER,))[LAYER]
    cells = cells_seen(shown, maps.shape[1:3]).reshape(2, -1, 1).astype(maps.dtype)
    x = normalise(maps.reshape(2, -1, maps.shape[-1]))
    head = network.aggregation
    vectors = head.flatten(head.residuals(x, head.soft_assignment(x) * cells))
    return {"vectors": vectors if network.whitening is None else network.whitening(vectors)}


def unite(kept: Mapping[str, np.ndarray], *, seed: int = 0) -> Places:
    """The vectors as they are."""
    return Places(jnp.asarray(kept["vectors"].transpose(0, 2, 1)))


def netvlad(weights: Path | None, arithmetic: Arithmetic) -> Descriptor:
    """Of the authors' files, or of pytorch-NetVlad and Patch-NetVLAD."""
    return network_descriptor("netvlad", weights, arithmetic, read, unite, side_px=SIDE_PX, accepted=("netvlad-nanne",))
