"""Descriptor matching in JAX: mutual nearest neighbours and Lowe's ratio, fixed shapes."""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ebjax.geometry.homography import Scalar
from ebjax.geometry.pytree import pytree


@pytree
class Features:
    """Keypoints (x, y) px and unit descriptors of one view; rows that are not `valid` hold anything."""

    keypoints: Float[Array, "*n K 2"]
    descriptors: Float[Array, "*n K D"]
    valid: Bool[Array, "*n K"]


@pytree
class Matches:
    """Rows of the two feature sets that belong together, best ratio first."""

    query: Int[Array, "*n M"]
    reference: Int[Array, "*n M"]
    ratio: Float[Array, "*n M"]
    valid: Bool[Array, "*n M"]


@partial(jax.jit, static_argnames="keep")
def mutual_nearest(query: Features, reference: Features, *, max_ratio: Scalar = 1.0, keep: int = 200) -> Matches:
    """Pairs that are each other's nearest neighbours, with distance / second distance at most `max_ratio`.

    Args:
      query: unit descriptors.
      reference: unit descriptors.
      max_ratio: Lowe's ratio, of Euclidean distances, from query to reference.
      keep: how many matches are returned, the most distinctive first.
    """
    similarity = query.descriptors @ reference.descriptors.T
    allowed = query.valid[:, None] & reference.valid[None, :]
    similarity = jnp.where(allowed, similarity, -2.0)
    best, back = jnp.max(similarity, axis=1), jnp.max(similarity, axis=0)
    # Where the maximum stands is looked up by comparing: XLA's CPU does not vectorise argmax.
    columns = jnp.arange(similarity.shape[1], dtype=jnp.int32)[None, :]
    nearest = jnp.min(jnp.where(similarity == best[:, None], columns, columns.size - 1), axis=1)
    second = jnp.max(jnp.where(columns == nearest[:, None], -2.0, similarity), axis=1)
    distance, others = (jnp.sqrt(jnp.maximum(2 - 2 * top, 1e-12)) for top in (best, second))
    ratio = distance / others
    good = (back[nearest] == best) & (best > -1.0) & (ratio <= max_ratio)
    order = jax.lax.top_k(-jnp.where(good, ratio, 2.0), min(keep, len(ratio)))[1].astype(jnp.int32)
    return Matches(order, nearest[order], ratio[order], good[order])
