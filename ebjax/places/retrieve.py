"""Causal retrieval: each view sees only earlier ones, in the same direction and from the opposite side, together.

The shortlist is by cosine of global descriptors, the ranking by shift-maximised correlation of descriptor maps. Everything is
one jitted program per block of queries; scores come from images alone, odometry only says which pairs may be compared.
"""

import dataclasses
import typing
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ebjax.places.correlation import Spectrum, correlate
from ebjax.places.descriptor_map import MapSpace


@typing.no_type_check
@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class LoopCandidates:
    """Ranked candidates of every query i: earlier view j, direction, distance (1 - score), shift of the maps in cells."""

    i: Int[Array, "Q K"]
    j: Int[Array, "Q K"]
    opposing: Bool[Array, "Q K"]
    distance: Float[Array, "Q K"]
    shift: Int[Array, "Q K 2"]
    valid: Bool[Array, "Q K"]


def comparable(
    times_s: Float[Array, "N"], travelled_m: Float[Array, "N"], gap_s: float, gap_m: float
) -> Bool[Array, "N N 2"]:
    """Which earlier views j a view i may be compared with, in the same direction ([..., 0]) and opposing ([..., 1]).

    Both leave out a time gap. The same direction also leaves out a travelled distance: until then the views overlap because
    the robot has hardly moved, which odometry knows better.
    """
    order = jnp.arange(times_s.shape[0])
    causal = (order[:, None] > order[None, :]) & (times_s[:, None] - times_s[None, :] >= gap_s)
    moved = travelled_m[:, None] - travelled_m[None, :] >= gap_m
    return jnp.stack([causal & moved, causal], -1)


@partial(jax.jit, static_argnames="k")
def cosine_top_k(
    queries: Float[Array, "Q V"], references: Float[Array, "N V 2"], allowed: Bool[Array, "Q N 2"], *, k: int
) -> tuple[Float[Array, "Q k"], Int[Array, "Q k"], Bool[Array, "Q k"]]:
    """The k best cosine scores of each query over both directions: score, reference index, whether it is opposing."""
    scores = jnp.einsum("qv,nvd->qnd", queries, references)
    scores = jnp.where(allowed, scores, -jnp.inf).reshape(queries.shape[0], -1)
    best, index = jax.lax.top_k(scores, min(k, scores.shape[1]))
    return best, (index // 2).astype(jnp.int32), (index % 2).astype(bool)


@jax.jit
def correlate_shortlist(
    spectra: Spectrum,
    query: Int[Array, "Q"],
    reference: Int[Array, "Q k"],
    opposing: Bool[Array, "Q k"],
    space: MapSpace,
) -> tuple[Float[Array, "Q k"], Int[Array, "Q k 2"]]:
    """Correlation score and shift of every shortlisted pair."""

    def one_query(args):
        i, js, ways = args
        ours = jax.tree.map(lambda leaf: leaf[i], spectra)

        def one_pair(pair):
            theirs = jax.tree.map(lambda leaf: leaf[pair[0]], spectra)
            return correlate(ours, theirs, pair[1], space)

        return jax.lax.map(one_pair, (js, ways))

    return jax.lax.map(one_query, (query, reference, opposing))
