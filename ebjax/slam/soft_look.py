"""What the differentiable path sees in a floor view: descriptors at points, and at the same points turned by pi."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Float

from ebjax.geometry.warp import rotate_pi, sample_bilinear
from ebjax.models.layers import normalise
from ebjax.models.rootsift import DIMENSION as SIFT
from ebjax.places.descriptor_map import dense_at, rotate_pi_scales
from ebjax.places.view import filled

Look = Callable[[Any, Float[Array, "H W 1"], Float[Array, "H W"], Float[Array, "K 2"]], Float[Array, "2 K D"]]
"""(weights, grey view, what is seen of it, points px) -> unit descriptors as it is ([0]) and turned by pi ([1])."""

ROOT_FLOOR = 1e-4
"""Smooths rootSIFT's root where a bin is empty; see `rootsift.root_normalise`."""
BIN_M = (0.06, 0.12)
"""Side of a bin of rootSIFT at both scales, on the floor, as in `places.descriptor_map`."""


DIMENSION = len(BIN_M) * SIFT


def _bins_px(metres_per_px: float) -> tuple[float, ...]:
    return tuple(bin_m / metres_per_px for bin_m in BIN_M)


def support(seen: Float[Array, "H W"], points: Float[Array, "K 2"], metres_per_px: float) -> Float[Array, "K"]:
    """The share of the surroundings of each point, as large as rootSIFT looks, that is seen."""
    return dense_at(jnp.zeros_like(seen), seen, points, _bins_px(metres_per_px))[1]


def rootsift_look(metres_per_px: float) -> Look:
    """Dense upright rootSIFT at two scales; it has no weights."""
    bins_px = _bins_px(metres_per_px)

    def look(weights: None, view: Float[Array, "H W 1"], seen: Float[Array, "H W"], points: Float[Array, "K 2"]):
        del weights
        values, _ = dense_at(view[..., 0], seen, points, bins_px, ROOT_FLOOR)
        values = normalise(values)
        return jnp.stack([values, rotate_pi_scales(values)])

    return look


def network_look(graph: nnx.GraphDef) -> Look:
    """The map of a network (grey NHWC in, any stride), read bilinearly; it looks at the turned view too.

    Args:
      graph: from `nnx.split(network)`, whose state is the look's weights.
    """

    def look(weights: Any, view: Float[Array, "H W 1"], seen: Float[Array, "H W"], points: Float[Array, "K 2"]):
        height, width = seen.shape
        whole = filled(view, seen)
        maps = nnx.merge(graph, weights)(jnp.stack([whole, rotate_pi(whole)]))
        stride = jnp.array([width / maps.shape[2], height / maps.shape[1]], points.dtype)
        turned = jnp.array([width - 1, height - 1], points.dtype)[None, :] - points
        read = [
            sample_bilinear(m, (p + 0.5) / stride[None, :] - 0.5) for m, p in zip(maps, (points, turned), strict=True)
        ]
        return normalise(jnp.stack(read))

    return look
