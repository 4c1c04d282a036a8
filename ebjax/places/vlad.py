"""NetVLAD aggregation of a descriptor map into one vector, with a k-means vocabulary from the run's own views.

Arandjelovic et al., "NetVLAD", CVPR 2016, equations 1 to 4: soft assignment to centres, residual sums,
intra-normalisation, unit length.
"""

import math
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, UInt32

from ebjax.geometry.pytree import pytree

SECOND_SHARE = 0.01
"""Of the second nearest centre against the nearest, on average: how soft the assignment is (NetVLAD's start)."""


@pytree
class Vocabulary:
    """Centres c_k, and alpha of the soft assignment exp(-alpha |x - c_k|^2): large is hard, the VLAD of Jegou 2010."""

    centres: Float[Array, "K D"]
    alpha: Float[Array, ""]


@partial(jax.jit, static_argnames=("clusters", "iterations"))
def kmeans(
    points: Float[Array, "M D"], *, clusters: int, key: PRNGKeyArray | UInt32[Array, "2"], iterations: int = 15
) -> Float[Array, "K D"]:
    """Lloyd's iterations from a random choice of points; an empty cluster keeps its centre."""
    first = jax.random.choice(key, points.shape[0], (clusters,), replace=points.shape[0] < clusters)

    def step(_, centres):
        score = 2 * points @ centres.T - jnp.sum(centres**2, 1)[None, :]
        member = jax.nn.one_hot(jnp.argmax(score, 1), clusters, dtype=points.dtype)
        count = member.sum(0)
        return jnp.where(count[:, None] > 0, member.T @ points / jnp.maximum(count, 1)[:, None], centres)

    return jax.lax.fori_loop(0, iterations, step, points[first])


@partial(jax.jit, static_argnames="clusters")
def learn_vocabulary(
    points: Float[Array, "M D"], *, clusters: int, key: PRNGKeyArray | UInt32[Array, "2"]
) -> Vocabulary:
    """Centres by k-means, and the alpha that gives the second nearest SECOND_SHARE of the nearest's share."""
    centres = kmeans(points, clusters=clusters, key=key)
    score = 2 * points @ centres.T - jnp.sum(centres**2, 1)[None, :]
    best = jax.lax.top_k(score, min(2, clusters))[0]
    gap = jnp.mean(best[:, 0] - best[:, -1])
    return Vocabulary(centres, -math.log(SECOND_SHARE) / jnp.maximum(gap, jnp.asarray(1e-6, points.dtype)))


def shares(values: Float[Array, "P D"], mask: Float[Array, "P"], words: Vocabulary) -> Float[Array, "P K"]:
    """How much of each descriptor belongs to each word; 0 for those that do not count."""
    score = 2 * values @ words.centres.T - jnp.sum(words.centres**2, 1)[None, :]
    return jax.nn.softmax(words.alpha * score, -1) * mask[:, None]


def aggregate(
    values: Float[Array, "P D"], share: Float[Array, "P K"], centres: Float[Array, "K D"]
) -> Float[Array, "KD"]:
    """V(k) = sum_p a_k(x_p) (x_p - c_k), each V(k) and the whole of unit length (NetVLAD, eq. 4).

    Args:
      values: the descriptors x_p of one view.
      share: a_k(x_p), 0 for what does not count.
      centres: the words c_k.
    """
    residual = share.T @ values - share.sum(0)[:, None] * centres
    tiny = jnp.asarray(1e-12, values.dtype)
    residual = residual / jnp.sqrt(jnp.sum(residual**2, 1, keepdims=True) + tiny)
    flat = residual.reshape(-1)
    return flat / jnp.sqrt(jnp.sum(flat**2) + tiny)


def vlad(values: Float[Array, "P D"], mask: Float[Array, "P"], words: Vocabulary) -> Float[Array, "KD"]:
    """`aggregate` by a vocabulary: of the descriptors of one view those whose `mask` is 1."""
    return aggregate(values, shares(values, mask, words), words.centres)


def netvlad(
    values: Float[Array, "P D"],
    mask: Float[Array, "P"],
    centres: Float[Array, "K D"],
    assignment: Float[Array, "D K"],
    bias: Float[Array, "K"],
) -> Float[Array, "KD"]:
    """`vlad` with a soft assignment of its own, a(x) = softmax(x assignment + bias) (NetVLAD, eq. 3 and 4).

    Args:
      values: the descriptors of one view.
      mask: which of them count, 1 or 0.
      centres: what residuals are taken from.
      assignment: w_k, one a column.
      bias: b_k.
    """
    return aggregate(values, jax.nn.softmax(values @ assignment + bias[None, :], -1) * mask[:, None], centres)


def centred(vectors: Float[Array, "N V 2"]) -> Float[Array, "N V 2"]:
    """Unit vectors without the mean over the run, in each orientation by itself: without what all places share."""
    vectors = vectors - jnp.mean(vectors, axis=0, keepdims=True)
    return vectors / jnp.maximum(jnp.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)
