"""Learns the components and the vocabulary of `FixedWords` from cells of maps of many floors."""

import math
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from ebjax.places.vlad import SECOND_SHARE

CHANNELS = 32
WORDS = 64
"""And as many mirror images."""
ITERATIONS = 15


def learn_words(
    cells: Float[Array, "M D0"], turn: Callable[[Array], Array], *, key: PRNGKeyArray
) -> dict[str, np.ndarray]:
    """Mean, basis, parity, words and alpha, as `FixedWords` has them.

    Args:
      cells: descriptors, one a row.
      turn: R_pi of the descriptors of a point, a linear map that is its own inverse.
      key: of the words that k-means begins with.
    """
    mean = jnp.mean(cells, 0)
    mean = (mean + turn(mean)) / 2
    rows = cells - mean[None]
    basis, parity = components(rows, turn)
    words, alpha = closed_kmeans(rows @ basis, parity, WORDS, key=key)
    made = {"mean": mean, "basis": basis, "parity": parity, "words": words, "alpha": alpha}
    return {name: np.asarray(array) for name, array in made.items()}


@partial(jax.jit, static_argnames="turn")
def components(
    rows: Float[Array, "M D0"], turn: Callable[[Array], Array]
) -> tuple[Float[Array, "D0 D"], Float[Array, "D"]]:
    """The principal directions of rows and turned rows together, CHANNELS at most, and the parity of each.

    The covariance of both is that of the even parts plus that of the odd parts: each is diagonalised by itself.
    """
    values, vectors = [], []
    for sign in (1, -1):
        part = (rows + sign * turn(rows)) / 2
        value, vector = jnp.linalg.eigh(jnp.matmul(part.T, part, precision="highest") / len(rows))
        vector = vector.T + sign * turn(vector.T)  # exactly even or odd
        values.append(value)
        vectors.append(vector / jnp.maximum(jnp.linalg.norm(vector, axis=1, keepdims=True), 1e-6))
    _, order = jax.lax.top_k(jnp.concatenate(values), min(CHANNELS, rows.shape[1]))
    parity = jnp.where(order < rows.shape[1], 1, -1).astype(rows.dtype)
    return jnp.concatenate(vectors)[order].T, parity


@partial(jax.jit, static_argnames="count")
def closed_kmeans(
    points: Float[Array, "M D"], parity: Float[Array, "D"], count: int, *, key: PRNGKeyArray
) -> tuple[Float[Array, "K D"], Float[Array, ""]]:
    """Lloyd's iterations over points and their mirror images with centres that come in such pairs, one of each.

    Returns:
      the centres; alpha, as `vlad.learn_vocabulary` chooses it.
    """
    first = points[jax.random.choice(key, len(points), (count,), replace=len(points) < count)]

    def scores(centres):
        both = jnp.concatenate([centres, centres * parity[None]])
        return 2 * points @ both.T - jnp.sum(both**2, 1)[None]

    def step(_, centres):
        best = jnp.argmax(scores(centres), 1)
        # A point that is nearest to a mirror image moves the centre as its own mirror image would.
        own = jnp.where((best >= count)[:, None], points * parity[None], points)
        member = jax.nn.one_hot(best % count, count, dtype=points.dtype)
        total = member.sum(0)
        return jnp.where(total[:, None] > 0, member.T @ own / jnp.maximum(total, 1)[:, None], centres)

    centres = jax.lax.fori_loop(0, ITERATIONS, step, first)
    best = jax.lax.top_k(scores(centres), 2)[0]
    gap = jnp.mean(best[:, 0] - best[:, 1])
    return centres, -math.log(SECOND_SHARE) / jnp.maximum(gap, jnp.asarray(1e-6, points.dtype))
