"""Descriptor matching in JAX: mutual nearest neighbours and Lowe's ratio, fixed shapes."""

import dataclasses
import typing

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int


@typing.no_type_check
@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Features:
    """Keypoints (x, y) px and unit descriptors of one view; rows that are not `valid` hold anything."""

    keypoints: Float[Array, "*n K 2"]
    descriptors: Float[Array, "*n K D"]
    valid: Bool[Array, "*n K"]


@typing.no_type_check
@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Matches:
    """Rows of the two feature sets that belong together, best ratio first."""

    query: Int[Array, "*n M"]
    reference: Int[Array, "*n M"]
    ratio: Float[Array, "*n M"]
    valid: Bool[Array, "*n M"]


def mutual_nearest(query: Features, reference: Features, *, max_ratio: float = 1.0, keep: int = 200) -> Matches:
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
    nearest = jnp.argmax(similarity, axis=1).astype(jnp.int32)
    first = jnp.take_along_axis(similarity, nearest[:, None], axis=1)
    columns = jnp.arange(similarity.shape[1], dtype=jnp.int32)
    others = jnp.where(columns[None, :] == nearest[:, None], -2.0, similarity)
    top = jnp.concatenate([first, jnp.max(others, axis=1, keepdims=True)], axis=1)
    back = jnp.argmax(similarity, axis=0).astype(jnp.int32)
    distance = jnp.sqrt(jnp.maximum(2 - 2 * top, 1e-12))
    ratio = distance[:, 0] / distance[:, 1]
    rows = jnp.arange(similarity.shape[0], dtype=jnp.int32)
    good = (back[nearest] == rows) & (top[:, 0] > -1.0) & (ratio <= max_ratio)
    order = jnp.argsort(jnp.where(good, ratio, 2.0))[:keep].astype(jnp.int32)
    return Matches(order, nearest[order], ratio[order], good[order])
