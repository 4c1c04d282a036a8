"""Loop candidates of a whole run from its dense place maps: learn the space and the vocabulary, shortlist, rank.

`ranking="correlation"` is the default: VLAD cosine makes a shortlist, shift-maximised correlation ranks it.
`ranking="cosine"` is the paper's plain single-vector cosine. Every step is one program, compiled once a size.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ebjax.places.descriptor_map import MapSpace, learn_space, project
from ebjax.places.retrieve import LoopCandidates, correlate_shortlist, merge, shortlist
from ebjax.places.vlad import kmeans, vlad

CHANNELS = 32
CLUSTERS = 32
SHORTLIST = 20
"""Views of each direction that are correlated with a query."""
SAMPLE_VIEWS = 256
SAMPLE_CELLS = 30_000
BLOCK = 32


def window(mask: Bool[np.ndarray, "r c"]) -> tuple[slice, slice]:
    """The smallest part of the grid, symmetric about its centre, that holds all cells that count.

    Raises:
      ValueError: none counts.
    """
    if not mask.any():
        raise ValueError("no cell of the view is seen well enough to be described; look at more floor")
    slices = []
    for axis in (1, 0):
        used = np.asarray(mask.any(axis))
        border = int(min(np.argmax(used), np.argmax(used[::-1])))
        slices.append(slice(border, len(used) - border))
    return slices[0], slices[1]


@jax.jit
def _project_block(block: Float[Array, "B r c D0"], space: MapSpace) -> Float[Array, "B r c D"]:
    return jax.vmap(lambda one: project(one.astype(space.mean.dtype), space))(block)


@partial(jax.jit, static_argnames="seed")
def _vocabulary(words: Float[Array, "M D"], *, seed: int) -> Float[Array, "K D"]:
    return kmeans(words, clusters=CLUSTERS, key=jax.random.key(seed))


@jax.jit
def _describe(maps: Float[Array, "N r c D"], centres: Float[Array, "K D"], space: MapSpace) -> Float[Array, "N V 2"]:
    weight = space.mask.reshape(-1)

    def both(values):
        cells = values.reshape(-1, values.shape[-1])  # sums over cells do not see that turning reverses their order
        return jnp.stack([vlad(side, weight, centres) for side in (cells, cells * space.parity[None, :])], -1)

    vectors = jax.lax.map(both, maps)
    vectors = vectors - jnp.mean(vectors, axis=0, keepdims=True)
    return vectors / jnp.maximum(jnp.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)


def global_descriptors(maps: Float[Array, "N r c D"], space: MapSpace, *, seed: int = 0) -> Float[Array, "N V 2"]:
    """VLAD of every view as it is ([..., 0], the query and same-direction reference) and turned by pi ([..., 1]).

    The vocabulary comes from the run's own cells, in both orientations. The mean over the run is taken away, as it is
    from the maps: it is what all places share.
    """
    host = np.asarray(maps).reshape(len(maps), -1, maps.shape[-1])
    cells = np.flatnonzero(np.asarray(space.mask))
    total = len(host) * len(cells)
    chosen = np.random.default_rng(seed).choice(total, min(total, SAMPLE_CELLS // 2), replace=False)
    rows = host[chosen // len(cells), cells[chosen % len(cells)]]
    words = np.concatenate([rows, rows * np.asarray(space.parity)[None, :]])
    return _describe(maps, _vocabulary(words, seed=seed), space)


def search(
    dense_maps: Float[np.ndarray, "N r c D0"],
    support: Float[Array, "r c"],
    allowed: Bool[Array, "Q N 2"],
    *,
    ranking: str = "correlation",
    min_support: float,
    seed: int = 0,
    queries: Int[np.ndarray, "Q"] | None = None,
    top: int = SHORTLIST,
    cells: Bool[np.ndarray, "N r c"] | None = None,
) -> LoopCandidates:
    """Up to `top` candidates of each direction for every query, ranked together, best first.

    Args:
      dense_maps: from `descriptor_map.dense`, one a view.
      support: share of each cell's descriptor inside the field of view.
      allowed: which views each query may be compared with, as from `retrieve.comparable`.
      ranking: "correlation" or "cosine".
      min_support: cells below it do not count.
      seed: of the vocabulary.
      queries: the rows of `dense_maps` that are queries; None: all.
      top: views of each direction that are shortlisted.
      cells: which cells of each view show floor, where that is known; None: all.

    Raises:
      ValueError: unknown ranking; no cell has enough support.
    """
    if ranking not in ("correlation", "cosine"):
        raise ValueError(f"ranking {ranking!r} is unknown; choose correlation or cosine")
    views = len(dense_maps)
    mask = np.asarray(support) > min_support
    rows, columns = window(mask)
    cut = dense_maps[:, rows, columns]
    sample = np.unique(np.linspace(0, views - 1, min(views, SAMPLE_VIEWS)).round().astype(int))
    space = learn_space(cut[sample], mask[rows, columns], CHANNELS)
    blocks = [np.asarray(_project_block(cut[np.arange(k, k + BLOCK) % views], space)) for k in range(0, views, BLOCK)]
    maps = jnp.asarray(np.concatenate(blocks)[:views])
    if cells is not None:
        maps = maps * jnp.asarray(cells[:, rows, columns, None], maps.dtype)
    asked = np.arange(views, dtype=np.int32) if queries is None else queries.astype(np.int32)
    cosine, j = shortlist(global_descriptors(maps, space, seed=seed), asked, allowed, k=top)
    if ranking == "cosine":
        score, shift = cosine, np.zeros((*j.shape, 2), np.int32)
    else:
        score, shift = correlate_shortlist(maps, asked, j, space)
    return merge(asked, j, score, shift, np.isfinite(cosine))
