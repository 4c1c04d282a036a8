"""NetVLAD aggregation of a descriptor map into one vector, with a k-means vocabulary from the run's own views.

Arandjelovic et al., "NetVLAD", CVPR 2016, equations 1 to 4: soft assignment to centres, residual sums,
intra-normalisation, unit length. A large `alpha` is hard assignment, the VLAD of Jegou et al. 2010.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, UInt32


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


def vlad(
    values: Float[Array, "P D"], mask: Float[Array, "P"], centres: Float[Array, "K D"], alpha: float = 30.0
) -> Float[Array, "KD"]:
    """V(k) = sum_p a_k(x_p) (x_p - c_k), each V(k) and the whole of unit length (NetVLAD, eq. 4).

    Args:
      values: the descriptors of one view.
      mask: which of them count, 1 or 0.
      centres: the vocabulary.
      alpha: inverse temperature of the soft assignment exp(-alpha |x - c|^2).
    """
    return netvlad(values, mask, centres, 2 * alpha * centres.T, -alpha * jnp.sum(centres**2, 1))


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
    share = jax.nn.softmax(values @ assignment + bias[None, :], -1) * mask[:, None]
    residual = share.T @ values - share.sum(0)[:, None] * centres
    tiny = jnp.asarray(1e-12, values.dtype)
    residual = residual / jnp.sqrt(jnp.sum(residual**2, 1, keepdims=True) + tiny)
    flat = residual.reshape(-1)
    return flat / jnp.sqrt(jnp.sum(flat**2) + tiny)


def centred(vectors: Float[Array, "N V 2"]) -> Float[Array, "N V 2"]:
    """Unit vectors without the mean over the run, in each orientation by itself: without what all places share."""
    vectors = vectors - jnp.mean(vectors, axis=0, keepdims=True)
    return vectors / jnp.maximum(jnp.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)
