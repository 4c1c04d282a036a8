"""Pairwise consistency of loop closures (PCM, Mangelson et al. 2018): the largest set that agrees with itself.

Two closures a = (i, j), b = (k, l) and the odometry between their ends make a cycle,
e = log(i_from_j * j_from_l * l_from_k * k_from_i), which is zero if both are right. They are consistent if
e^T S^-1 e, with S from the closures' covariances and the odometry walked through, passes a chi-square test with three
degrees of freedom. SE(2): poses are (x, y, theta), m and rad.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ebjax.geometry.lie import se2_adjoint, se2_compose, se2_inverse, se2_log, small_matmul

CHI2_99 = 11.345  # 99 % point with three degrees of freedom
_NODES = 20_000


def consistent_set(
    odometry_poses: Float[Array | np.ndarray, "N 3"],
    step_sigmas: Float[Array | np.ndarray, "*n 3"] | Sequence[float],
    i: Int[Array | np.ndarray, " K"],
    j: Int[Array | np.ndarray, " K"],
    i_from_j: Float[Array | np.ndarray, "K 3"],
    covariance: Float[Array | np.ndarray, "K 3 3"],
    weights: Float[Array | np.ndarray, " K"],
    *,
    threshold: float = CHI2_99,
) -> Bool[np.ndarray, " K"]:
    """Marks the largest set of mutually consistent closures; of equal ones, the one of largest total weight.

    A single closure agrees with itself: one that nothing supports can be returned alone, and telling that from a good
    one is the caller's part. The search is exact for what occurs in practice (branch and bound; after 20,000 nodes
    the best set so far is returned, never smaller than the greedy one).

    Args:
      odometry_poses: world_from_base along the path.
      step_sigmas: standard deviations (x m, y m, theta rad) of one odometry step in its own frame, for all or per step.
      i: row of the frame the closure is measured in.
      j: row of the frame it measures.
      i_from_j: the measurements.
      covariance: of log(measured^-1 * true).
      weights: what breaks ties, for example inliers; not negative.
      threshold: on the squared Mahalanobis distance of a cycle.
    """
    if len(i) == 0:
        return np.zeros(0, bool)
    dtype = jnp.result_type(float)
    poses, z, cov = (jnp.asarray(x, dtype) for x in (odometry_poses, i_from_j, covariance))
    sigmas = jnp.broadcast_to(jnp.asarray(step_sigmas, dtype), (len(poses) - 1, 3))
    distance = cycle_distances(poses, sigmas, jnp.asarray(i), jnp.asarray(j), z, cov)
    return largest_clique(np.asarray(distance <= threshold), np.asarray(weights, float))


@jax.jit
def cycle_distances(
    odometry_poses: Float[Array, "N 3"],
    step_sigmas: Float[Array, "M 3"],
    i: Int[Array, " K"],
    j: Int[Array, " K"],
    i_from_j: Float[Array, "K 3"],
    covariance: Float[Array, "K 3 3"],
) -> Float[Array, "K K"]:
    """Squared Mahalanobis distance of the cycle that every pair of closures makes; symmetric up to second order.

    Step errors are independent, so in the world frame they add up along the path: C_n = sum Ad Q Ad^T, and the
    odometry from m to n has covariance C_n - C_m. Steps that both halves of a cycle walk through count twice.
    """
    centre = jnp.mean(odometry_poses[:, :2], 0, keepdims=True)
    poses = odometry_poses.at[:, :2].add(-centre)
    ad = se2_adjoint(poses[1:])
    steps = jnp.sum(ad[:, :, None, :] * ad[:, None, :, :] * step_sigmas[:, None, None, :] ** 2, -1)
    walked = jnp.concatenate([jnp.zeros_like(steps[:1]), jnp.cumsum(steps, 0)])

    def between(m, n):
        relative = se2_compose(se2_inverse(poses[m]), poses[n])
        spread = jnp.where((n > m)[..., None, None], 1, -1) * (walked[n] - walked[m])
        return relative, _carry(se2_inverse(poses[n]), spread)

    k = len(i)
    a, b = jnp.meshgrid(jnp.arange(k), jnp.arange(k), indexing="ij")
    a, b = a.ravel(), b.ravel()
    j_from_l, cov_jl = between(j[a], j[b])
    k_from_i, cov_ki = between(i[b], i[a])
    tail = se2_compose(se2_inverse(i_from_j[b]), k_from_i)
    rest = se2_compose(j_from_l, tail)
    error = se2_log(se2_compose(i_from_j[a], rest))
    spread = _carry(se2_inverse(rest), covariance[a]) + _carry(se2_inverse(tail), cov_jl + covariance[b]) + cov_ki
    solved = jnp.linalg.solve(spread, error[:, :, None])[:, :, 0]
    return jnp.sum(error * solved, -1).reshape(k, k)


def _carry(pose, covariance):
    ad = se2_adjoint(pose)
    return small_matmul(small_matmul(ad, covariance), ad.swapaxes(-1, -2))


def largest_clique(
    consistent: Bool[np.ndarray, "K K"], weights: Float[np.ndarray, " K"], *, nodes: int = _NODES
) -> Bool[np.ndarray, " K"]:
    """The largest clique, ties by total weight: branch and bound with greedy colouring as the bound (Tomita)."""
    k = len(weights)
    adjacent = consistent & consistent.T & ~np.eye(k, dtype=bool)
    order = np.lexsort((-weights, -adjacent.sum(1)))
    adjacent, w = adjacent[np.ix_(order, order)], weights[order].tolist()
    masks = [sum(1 << int(q) for q in np.flatnonzero(row)) for row in adjacent]
    best: tuple[int, float, list[int]] = (0, 0.0, [])
    left = nodes

    def colour(candidates):
        """Candidates by colour class, each with the bounds (count, weight) of everything up to it."""
        out, count, total = [], 0, 0.0
        while candidates:
            count += 1
            free, heaviest = candidates, 0.0
            members = []
            while free:
                p = (free & -free).bit_length() - 1
                free &= ~(1 << p) & ~masks[p]
                candidates &= ~(1 << p)
                heaviest = max(heaviest, w[p])
                members.append(p)
            total += heaviest
            out += [(p, count, total) for p in members]
        return out

    def grow(clique, weight, candidates):
        nonlocal best, left
        if (len(clique), weight) > best[:2]:
            best = (len(clique), weight, clique)
        for p, count, total in reversed(colour(candidates)):
            left -= 1
            if left < 0 or (len(clique) + count, weight + total) <= best[:2]:
                return
            grow([*clique, p], weight + w[p], candidates & masks[p])
            candidates &= ~(1 << p)

    greedy, candidates = [], (1 << k) - 1
    while candidates:
        p = (candidates & -candidates).bit_length() - 1
        greedy.append(p)
        candidates &= masks[p]
    best = (len(greedy), sum(w[p] for p in greedy), greedy)
    grow([], 0.0, (1 << k) - 1)
    out = np.zeros(k, bool)
    out[order[best[2]]] = True
    return out
