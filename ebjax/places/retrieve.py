"""Causal retrieval: each view sees only earlier ones, in the same direction and from the opposite side, together.

The shortlist is by cosine of global descriptors, the ranking by shift-maximised correlation of descriptor maps, each
one jitted program over all queries. Scores come from images alone; odometry only says which pairs may be compared.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ebjax.geometry.pytree import pytree
from ebjax.places.correlation import correlate, overlap_weight, spectrum
from ebjax.places.descriptor_map import MapSpace

BLOCK = 512


@pytree
class LoopCandidates:
    """Ranked candidates of every query i: view j, direction, distance (1 - score), shift of the maps in cells."""

    i: Int[Array, "Q K"]
    j: Int[Array, "Q K"]
    opposing: Bool[Array, "Q K"]
    distance: Float[Array, "Q K"]
    shift: Int[Array, "Q K 2"]
    valid: Bool[Array, "Q K"]


@partial(jax.jit, static_argnames=("gap_s", "gap_m"))
def comparable(
    times_s: Float[Array, "N"], travelled_m: Float[Array, "N"], gap_s: float, gap_m: float
) -> Bool[Array, "N N 2"]:
    """Which earlier views j a view i may be compared with, in the same direction ([..., 0]) and opposing ([..., 1]).

    Both leave out a time gap. The same direction also leaves out a travelled distance: until then the views overlap
    because the robot has hardly moved, which odometry knows better.
    """
    order = jnp.arange(times_s.shape[0])
    causal = (order[:, None] > order[None, :]) & (times_s[:, None] - times_s[None, :] >= gap_s)
    moved = travelled_m[:, None] - travelled_m[None, :] >= gap_m
    return jnp.stack([causal & moved, causal], -1)


@partial(jax.jit, static_argnames="k")
def cosine_top_k(
    queries: Float[Array, "Q V"],
    references: Float[Array, "N V"],
    allowed: Bool[Array, "Q N"] | None = None,
    *,
    k: int,
) -> tuple[Float[Array, "Q k"], Int[Array, "Q k"]]:
    """The k best cosine scores of each query, best first, and their references; -inf where fewer are allowed.

    Exhaustive and so exact, to rounding. Of equal scores the earlier reference comes first.
    """

    def best(query, allowed):
        # XLA reads the references once for many queries, but takes 17 times as long for one row as for one column.
        scores = references @ query
        return tuple(jax.lax.top_k(jnp.where(allowed, scores, -jnp.inf), min(k, len(references))))

    every = jnp.ones((1, 1), bool) if allowed is None else allowed
    if len(queries) == 1:
        return jax.tree.map(lambda leaf: leaf[None], best(queries[0], every[0]))
    every = jnp.broadcast_to(every, (len(queries), every.shape[1]))
    # Scores of a block of queries at a time: they stay in the cache, and memory does not grow with the queries.
    return jax.lax.map(lambda row: best(*row), (queries, every), batch_size=BLOCK)


@partial(jax.jit, static_argnames="k")
def shortlist(
    vectors: Float[Array, "N V 2"], queries: Int[Array, "Q"], allowed: Bool[Array, "Q N 2"], *, k: int
) -> tuple[Float[Array, "Q 2 k"], Int[Array, "Q 2 k"]]:
    """The k best of each direction by cosine ([:, 0] the same, [:, 1] opposing): neither crowds the other out."""
    ways = [cosine_top_k(vectors[queries, :, 0], vectors[..., way], allowed[..., way], k=k) for way in (0, 1)]
    cosine, j = (jnp.stack(parts, 1) for parts in zip(*ways, strict=True))
    return cosine, j


@jax.jit
def correlate_shortlist(
    maps: Float[Array, "N h w D"], queries: Int[Array, "Q"], references: Int[Array, "Q 2 k"], space: MapSpace
) -> tuple[Float[Array, "Q 2 k"], Int[Array, "Q 2 k 2"]]:
    """Correlation score and shift of every shortlisted pair, laid out as `shortlist` gives them."""
    spectra = jax.lax.map(lambda one: spectrum(one, space), maps)
    weight = overlap_weight(space)

    def one_query(args):
        i, js = args
        ours = jax.tree.map(lambda leaf: leaf[i], spectra)
        ways = []
        for way in (0, 1):
            theirs = jax.tree.map(lambda leaf: leaf[js[way]], spectra)  # noqa: B023 - called at once
            ways.append(correlate(ours, theirs, weight, space, opposing=bool(way)))
        score, shift = (jnp.stack(parts) for parts in zip(*ways, strict=True))
        return score, shift

    return jax.lax.map(one_query, (queries, references))


@jax.jit
def merge(
    queries: Int[Array, "Q"],
    references: Int[Array, "Q 2 k"],
    score: Float[Array, "Q 2 k"],
    shift: Int[Array, "Q 2 k 2"],
    valid: Bool[Array, "Q 2 k"],
) -> LoopCandidates:
    """Both directions ranked together by score, best first, what is not valid last."""

    def flat(values):
        return values.reshape(values.shape[0], -1, *values.shape[3:])

    opposing = jnp.broadcast_to(jnp.array([False, True])[None, :, None], references.shape)
    best, order = jax.lax.top_k(flat(jnp.where(valid, score, -jnp.inf)), 2 * score.shape[2])
    j, opposing, valid = (jnp.take_along_axis(flat(a), order, 1) for a in (references, opposing, valid))
    shift = jnp.take_along_axis(flat(shift), order[..., None], 1)
    i = jnp.broadcast_to(queries[:, None], j.shape)
    return LoopCandidates(i, j, opposing, 1 - best, shift, valid)
