"""What the words of a run say of its views: a vector each, and how much every cell of a map counts.

A pattern that fills a view, grout or a patch of sun, says little more than one piece of it: n cells of one word in a
view weigh as much as sqrt(n) (Jegou, Douze and Schmid, "On the burstiness of visual elements", CVPR 2009).
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ebjax.places.descriptor_map import MapSpace
from ebjax.places.vlad import Vocabulary, aggregate, centred, learn_vocabulary, shares

CLUSTERS = 128
SAMPLE_CELLS = 30_000


def words_of(samples: Float[np.ndarray, "M D"], *, seed: int) -> Vocabulary:
    """CLUSTERS words from some of a run's descriptors."""
    return _learn(jnp.asarray(samples), seed=seed)


@partial(jax.jit, static_argnames="seed")
def _learn(samples: Float[Array, "M D"], *, seed: int) -> Vocabulary:
    return learn_vocabulary(samples, clusters=CLUSTERS, key=jax.random.key(seed))


@jax.jit
def _describe(
    maps: Float[Array, "N h w D"], words: Vocabulary, parity: Float[Array, "D"]
) -> tuple[Float[Array, "N V 2"], Float[Array, "N h w D"]]:
    def one(values):
        cells = values.reshape(-1, values.shape[-1])
        seen = jnp.any(cells != 0, 1).astype(cells.dtype)
        sides, counts = [], jnp.zeros_like(seen)
        # Sums over cells do not see that turning reverses their order.
        for side in (cells, cells * parity[None, :]):
            share = shares(side, seen, words)
            sides.append(aggregate(side, share, words.centres))
            counts += share @ (1 / jnp.sqrt(1 + share.sum(0)))
        return jnp.stack(sides, -1), values * counts.reshape(*values.shape[:2], 1)

    vectors, weighed = jax.lax.map(one, maps)
    return centred(vectors), weighed


def by_words(
    maps: Float[Array, "N h w D"], space: MapSpace, *, seed: int = 0
) -> tuple[Float[Array, "N V 2"], Float[Array, "N h w D"]]:
    """VLAD of every view, and the maps with every cell weighed by how rare its words are in its view.

    The vocabulary comes from the run's own cells, in both orientations. The mean over the run is taken away from the
    vectors, as it is from the maps: it is what all places share.

    Args:
      maps: centred, 0 in cells that are not seen.
      space: of the maps.
      seed: of the vocabulary.

    Returns:
      unit vectors of the views as they are ([..., 0], the query and same-direction reference) and turned by pi
      ([..., 1]); weighed maps, which turn as the maps do.
    """
    host = np.asarray(maps).reshape(len(maps), -1, maps.shape[-1])
    cells = np.flatnonzero(np.asarray(space.mask))
    total = len(host) * len(cells)
    chosen = np.random.default_rng(seed).choice(total, min(total, SAMPLE_CELLS // 2), replace=False)
    rows = host[chosen // len(cells), cells[chosen % len(cells)]]
    return _describe(
        maps, words_of(np.concatenate([rows, rows * np.asarray(space.parity)[None, :]]), seed=seed), space.parity
    )
