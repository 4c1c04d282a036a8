"""Networks as global descriptors: their weights, and how they look at a view and at the same view turned by pi.

A network is not equivariant, so it looks at the turned view too, as in the paper. What is not seen is filled with the
mean colour of the rest, and cells of its map that are less than half seen do not count.
"""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from ebjax.models.fast import Arithmetic
from ebjax.models.locate import open_network
from ebjax.places.descriptor import Descriptor, Unite
from ebjax.places.view import filled, resized

Read = Callable[[Any, Float[Array, "2 H W 3"], Float[Array, "2 H W"]], Mapping[str, Array]]


def network_descriptor(
    name: str,
    weights: Path | None,
    arithmetic: Arithmetic,
    read: Read,
    unite: Unite,
    *,
    side_px: int,
    accepted: tuple[str, ...] = (),
) -> Descriptor:
    """A descriptor that reads a network.

    Args:
      name: of the network in `ebjax.models.catalogue`.
      weights: a .safetensors file, a folder of them, or None for the usual place.
      arithmetic: see `ebjax.models.locate.open_network`.
      read: (network; the view and the turned view, RGB in [0, 1]; what they show, 1 or 0) -> what is kept.
      unite: as in `Descriptor`.
      side_px: the longer side of what the network sees.
      accepted: other networks of the catalogue that will do.

    Raises:
      ValueError: there are no such weights, or they are another network's.
    """
    path, _, network = open_network(name, weights, arithmetic, accepted=accepted)
    graph, state = nnx.split(network)

    # The weights are arguments of one program: as constants in it they would be compiled.
    def look(view: Float[Array, "H W 3"], seen: Bool[Array, "H W"], image: Any) -> Mapping[str, Array]:
        return _look(graph, state, jnp.asarray(view), jnp.asarray(seen), read, side_px)

    return Descriptor(look, unite, jitted=False, side_px=side_px, weights=path)


@partial(jax.jit, static_argnames=("graph", "read", "side_px"))
def _look(
    graph: Any, state: Any, view: Float[Array, "H W 3"], seen: Bool[Array, "H W"], read: Read, side_px: int
) -> Mapping[str, Array]:
    shown = seen.astype(view.dtype)
    view = resized(filled(view, shown), side_px)
    shown = resized(shown[..., None], side_px)[..., 0]
    both = (jnp.stack([one, one[::-1, ::-1]]) for one in (view, shown))
    return read(nnx.merge(graph, state), *both)
