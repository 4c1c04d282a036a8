"""The loop measurement without a hard choice: dual-softmax matches and a reweighted Kabsch, differentiable throughout.

    P_uv = softmax_u(s_uv / T) softmax_v(s_uv / T),   s_uv = <a_u, b_v>

(Rocco et al., NCNet, 2018; Sun et al., LoFTR, 2021). Point u of the query goes with the mean of the reference's points
under P_u, with weight sum_v P_uv: for Kabsch that is the same as all pairs (u, v) with weights P_uv.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ebjax.features.measure import LoopMeasurement, measure_floor
from ebjax.geometry.rigid import kabsch

SCALES_M = (0.4, 0.2, 0.1, 0.06, 0.06)
"""Residuals at which a match is doubted, from step to step: wrong matches lose their say, gradually."""


def dual_softmax(
    query: Float[Array, "K D"],
    reference: Float[Array, "M D"],
    query_weight: Float[Array, "K"],
    reference_weight: Float[Array, "M"],
    temperature: float,
) -> Float[Array, "K M"]:
    """P, zero for rows and columns of weight 0.

    Args:
      query: unit descriptors.
      reference: unit descriptors.
      query_weight: 1 or 0, which of them count.
      reference_weight: 1 or 0.
      temperature: T; smaller is harder.
    """
    scores = query @ reference.T / temperature
    away = jnp.asarray(-1e9, scores.dtype)
    by_row = jax.nn.softmax(jnp.where(reference_weight[None, :] > 0, scores, away), 1)
    by_column = jax.nn.softmax(jnp.where(query_weight[:, None] > 0, scores, away), 0)
    return by_row * by_column * query_weight[:, None] * reference_weight[None, :]


def soft_measure(
    points_i: Float[Array, "K 2"], points_j: Float[Array, "M 2"], matches: Float[Array, "K M"]
) -> LoopMeasurement:
    """p_i = R p_j + t over soft matches by reweighted least squares, with Geman and McClure's weights.

    Args:
      points_i: on the floor, in base_i, m.
      points_j: on the floor, in base_j, m.
      matches: from `dual_softmax`.
    """
    matches = matches.astype(points_i.dtype)
    share = jnp.sum(matches, 1)
    partners = matches @ points_j / (share + 1e-9)[:, None]

    def doubt(weights, scale_m):
        rotation, translation = kabsch(partners, points_i, weights)
        squared = jnp.sum((points_i - (partners @ rotation.T + translation[None, :])) ** 2, 1)
        return share * (scale_m**2 / (scale_m**2 + squared)) ** 2, None

    weights, _ = jax.lax.scan(doubt, share, jnp.asarray(SCALES_M, share.dtype))
    return measure_floor(points_i, partners, weights)
