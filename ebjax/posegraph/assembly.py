"""From edge blocks to the symmetric block-sparse system H x = b, the shape every linear solver here takes.

H has a d x d block per pose and one per pair of poses that share edges; a pair's block is stored once, in the
orientation (first, second) that its solver wants. Fixed poses keep an identity block and no neighbours; so do single
numbers of a tangent that are held, as the rotation of a landmark is.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ebjax.posegraph.factors import EdgeBlocks
from ebjax.posegraph.graph import PoseGraph


class Pattern(NamedTuple):
    """Per edge the `slot` of its pair block (S = nowhere) and if it takes the transpose; per slot (first, second).

    No `flipped` means that none does. Slots without a pair say (0, 0) and stay zero.
    """

    slot: Int[Array | np.ndarray, " E"]
    flipped: Bool[Array | np.ndarray, " E"] | None
    first: Int[Array | np.ndarray, " S"]
    second: Int[Array | np.ndarray, " S"]


class System(NamedTuple):
    """Blocks of H: `diagonal` H_pp, `off` H_(first, second)."""

    diagonal: Float[Array, "N d d"]
    off: Float[Array, "S d d"]


def make_pattern(
    graph: PoseGraph, rank: Int[np.ndarray, " N"] | None = None, fill: list[tuple[int, int]] | None = None
) -> Pattern:
    """Numbers the pairs of free poses that share an edge, then the pairs in `fill`; the lower `rank` comes first.

    Without `rank` a pair is oriented as its first edge. The slots are as many as the edges, and the poses if there is
    fill: graphs of one size share a compiled program. Host code: `i`, `j` and `fixed` must be concrete.
    """
    i, j, fixed = (np.asarray(x) for x in (graph.i, graph.j, graph.fixed))
    live = ~(fixed[i] | fixed[j]) & (i != j)
    n = max(len(fixed), 1)
    if rank is None:
        _, where, which = np.unique(np.minimum(i, j) * n + np.maximum(i, j), return_index=True, return_inverse=True)
        flipped = i != i[where[which]]
    else:
        flipped = rank[i] > rank[j]
    first, second = np.where(flipped, j, i), np.where(flipped, i, j)
    keys, slot = np.unique((first * n + second)[live], return_inverse=True)
    extra = np.array([a * n + b for a, b in fill or []], keys.dtype)
    keys = np.concatenate([keys, np.setdiff1d(extra, keys)])
    room = max(len(i) + (0 if fill is None else n), len(keys))
    slots = np.full(len(i), room)
    slots[live] = slot
    keys = np.concatenate([keys, np.zeros(room - len(keys), keys.dtype)])
    return Pattern(slots, flipped if flipped[live].any() else None, keys // n, keys % n)


def assemble(
    graph: PoseGraph, pattern: Pattern, blocks: EdgeBlocks, free: Bool[Array, " N"] | Bool[Array, "N d"]
) -> tuple[System, Float[Array, "N d"]]:
    """Sums edge blocks into H and edge gradients into the gradient of the free poses, or free numbers of a tangent."""
    n, d = free.shape[0], blocks.gi.shape[-1]
    dtype = blocks.gi.dtype
    gradient = jnp.zeros((n, d), dtype).at[graph.i].add(blocks.gi).at[graph.j].add(blocks.gj)
    diagonal = jnp.zeros((n, d, d), dtype).at[graph.i].add(blocks.ii).at[graph.j].add(blocks.jj)
    off = jnp.zeros((len(pattern.first), d, d), dtype)
    ij = blocks.ij
    if pattern.flipped is not None:
        ij = jnp.where(pattern.flipped[:, None, None], ij.swapaxes(-1, -2), ij)
    off = off.at[pattern.slot].add(ij, mode="drop")
    eye = jnp.broadcast_to(jnp.eye(d, dtype=dtype), diagonal.shape)
    if free.ndim == 2:
        diagonal = jnp.where(free[:, :, None] & free[:, None, :], diagonal, eye)
        off = jnp.where(free[pattern.first][:, :, None] & free[pattern.second][:, None, :], off, 0)
    else:
        diagonal = jnp.where(free[:, None, None], diagonal, eye)
    return System(diagonal, off), jnp.where(numbers(free), gradient, 0)


def numbers(free: Bool[Array, " N"] | Bool[Array, "N d"]) -> Bool[Array, "N #d"]:
    """The mask of rows or of their numbers, as one that goes with tangents."""
    return free if free.ndim == 2 else free[:, None]


def damped(system: System, damping: Float[Array, ""]) -> System:
    """H + damping I."""
    d = system.diagonal.shape[-1]
    return system._replace(diagonal=system.diagonal + damping * jnp.eye(d, dtype=system.off.dtype)[None])


def matvec(system: System, pattern: Pattern, x: Float[Array, "N d"]) -> Float[Array, "N d"]:
    """H x."""
    y = jnp.sum(system.diagonal * x[:, None, :], -1)
    y = y.at[pattern.first].add(jnp.sum(system.off * x[pattern.second][:, None, :], -1))
    return y.at[pattern.second].add(jnp.sum(system.off * x[pattern.first][:, :, None], -2))
