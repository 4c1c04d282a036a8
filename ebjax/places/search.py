"""Loop candidates of a whole run from its dense place maps: learn the space and the vocabulary, shortlist, rank.

`ranking="correlation"` is the default: VLAD cosine makes a shortlist, shift-maximised correlation ranks it. `ranking="cosine"`
is the paper's plain single-vector cosine.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ebjax.places.correlation import spectrum
from ebjax.places.descriptor_map import MapSpace, learn_space, project, rotate_pi_map
from ebjax.places.retrieve import LoopCandidates, correlate_shortlist, cosine_top_k
from ebjax.places.vlad import kmeans, vlad

CHANNELS = 32
CLUSTERS = 32
SHORTLIST = 20
"""Views of each direction that are correlated with a query."""
SAMPLE_VIEWS = 256
SAMPLE_CELLS = 30_000
BLOCK = 256


def global_descriptors(maps: Float[Array, "N r c D"], space: MapSpace, *, seed: int = 0) -> Float[Array, "N V 2"]:
    """VLAD of every view as it is ([..., 0], the query and same-direction reference) and turned by pi ([..., 1]).

    The vocabulary comes from the run's own cells, in both orientations. The mean over the run is taken away, as it is from
    the maps: it is what all places share.
    """
    rows = np.asarray(maps)[:, np.asarray(space.mask) > 0].reshape(-1, maps.shape[-1])
    rng = np.random.default_rng(seed)
    rows = rows[rng.choice(len(rows), min(len(rows), SAMPLE_CELLS // 2), replace=False)]
    words = np.concatenate([rows, rows * np.asarray(space.parity)])
    centres = kmeans(jnp.asarray(words), clusters=CLUSTERS, key=jax.random.key(seed))
    weight = space.mask.reshape(-1)

    def both(values):
        turned = rotate_pi_map(values, space)
        sides = (values.reshape(-1, values.shape[-1]), turned.reshape(-1, values.shape[-1]))
        masks = (weight, weight[::-1])
        return jnp.stack([vlad(side, mask, centres) for side, mask in zip(sides, masks, strict=True)], -1)

    vectors = jax.jit(lambda m: jax.lax.map(both, m))(maps)
    vectors = vectors - jnp.mean(vectors, axis=0, keepdims=True)
    return vectors / jnp.maximum(jnp.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)


def shortlist(
    vectors: Float[Array, "N V 2"], allowed: Bool[Array, "N N 2"], count: int
) -> tuple[Float[Array, "N k"], Int[Array, "N k"], Bool[Array, "N k"]]:
    """The best `count` of each direction by cosine, merged, best first: neither direction crowds the other out."""
    views = vectors.shape[0]
    ways = [
        cosine_top_k(vectors[..., 0], vectors, allowed & (jnp.arange(2) == way)[None, None, :], k=min(count, views))
        for way in (0, 1)
    ]
    cosine, j, opposing = (jnp.concatenate(parts, 1) for parts in zip(*ways, strict=True))
    order = jnp.argsort(-cosine, axis=1)
    cosine, j, opposing = (jnp.take_along_axis(values, order, axis=1) for values in (cosine, j, opposing))
    return cosine, j, opposing


def search(
    dense_maps: Float[np.ndarray, "N r c D0"],
    support: Float[Array, "r c"],
    allowed: Bool[Array, "N N 2"],
    *,
    ranking: str = "correlation",
    min_support: float,
    seed: int = 0,
) -> LoopCandidates:
    """Up to SHORTLIST candidates of each direction for every view, ranked together, best first.

    Args:
      dense_maps: from `descriptor_map.dense`, one a view.
      support: share of each cell's descriptor inside the field of view.
      allowed: from `retrieve.comparable`.
      ranking: "correlation" or "cosine".
      min_support: cells below it do not count.
      seed: of the vocabulary.

    Raises:
      ValueError: unknown ranking.
    """
    if ranking not in ("correlation", "cosine"):
        raise ValueError(f"ranking {ranking!r} is unknown; choose correlation or cosine")
    views = len(dense_maps)
    sample = np.unique(np.linspace(0, views - 1, min(views, SAMPLE_VIEWS)).round().astype(int))
    space = learn_space(jnp.asarray(dense_maps[sample], jnp.float32), jnp.asarray(support) > min_support, CHANNELS)
    reduce = jax.jit(lambda block: jax.vmap(lambda m: project(m.astype(jnp.float32), space))(block))
    maps = jnp.concatenate([reduce(dense_maps[k : k + BLOCK]) for k in range(0, views, BLOCK)])
    vectors = global_descriptors(maps, space, seed=seed)
    cosine, j, opposing = shortlist(vectors, allowed, SHORTLIST)
    valid = jnp.isfinite(cosine)
    i = jnp.broadcast_to(jnp.arange(views, dtype=jnp.int32)[:, None], j.shape)
    if ranking == "cosine":
        return LoopCandidates(i, j, opposing, 1 - cosine, jnp.zeros((*j.shape, 2), jnp.int32), valid)
    spectra = jax.jit(lambda m: jax.lax.map(lambda one: spectrum(one, space), m))(maps)
    score, shift = correlate_shortlist(spectra, i[:, 0], j, opposing, space)
    score = jnp.where(valid, score, -jnp.inf)
    order = jnp.argsort(-score, axis=1)
    score, i, j, opposing, valid = (
        jnp.take_along_axis(values, order, axis=1) for values in (score, i, j, opposing, valid)
    )
    shift = jnp.take_along_axis(shift, order[..., None], axis=1)
    return LoopCandidates(i, j, opposing, 1 - score, shift, valid)
