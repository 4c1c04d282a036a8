"""Pairwise consistency of loop closures (PCM, Mangelson et al. 2018): the largest set that agrees with itself.

Two closures a = (i, j), b = (k, l) and the odometry between their ends make a cycle,
e = log(i_from_j * j_from_l * l_from_k * k_from_i), which is zero if both are right. They are consistent if
e^T S^-1 e, with S from the closures' covariances and the odometry walked through, passes a chi-square test with as
many degrees of freedom as a pose has. SE(2) and SE(3), told apart by the width of a pose; m and rad.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ebjax.geometry.lie import GROUPS
from ebjax.geometry.small_angle import small_matmul
from ebjax.posegraph.capacity import capacity, concrete, filled
from ebjax.posegraph.robust import CHI2_99

_NODES, _WORK = 20_000, 10_000_000  # a node of the search costs as much work as there are closures, at most


class Loops(NamedTuple):
    """Closures to be compared, and the path between them; see `make_loops`."""

    poses: Float[Array | np.ndarray, "N P"]
    walked: Float[Array | np.ndarray, "N d d"]
    i: Int[Array | np.ndarray, " K"]
    j: Int[Array | np.ndarray, " K"]
    i_from_j: Float[Array | np.ndarray, "K P"]
    covariance: Float[Array | np.ndarray, "K d d"]


def consistent_set(
    odometry_poses: Float[Array | np.ndarray, "N P"],
    steps: Float[Array | np.ndarray, "M d d"] | Float[Array | np.ndarray, "*n d"] | Sequence[float],
    i: Int[Array | np.ndarray, " K"],
    j: Int[Array | np.ndarray, " K"],
    i_from_j: Float[Array | np.ndarray, "K P"],
    covariance: Float[Array | np.ndarray, "K d d"],
    weights: Float[Array | np.ndarray, " K"],
    *,
    threshold: float | None = None,
) -> Bool[np.ndarray, " K"]:
    """Marks the largest set of mutually consistent closures; of equal ones, the one of largest total weight.

    A single closure agrees with itself: one that nothing supports can be returned alone, and telling that from a good
    one is the caller's part. The search is exact for what occurs in practice (branch and bound; after 20,000 nodes,
    fewer with more than 500 closures, the best set so far is returned, never smaller than the greedy one).

    Args:
      odometry_poses: world_from_base along the path.
      steps: covariance of every odometry step in its own frame, or standard deviations, per step or of all.
      i: row of the frame the closure is measured in.
      j: row of the frame it measures.
      i_from_j: the measurements.
      covariance: of log(measured^-1 * true).
      weights: what breaks ties, for example inliers; not negative.
      threshold: on the squared Mahalanobis distance of a cycle; None is the 99 % point of chi-square.
    """
    if len(i) == 0:
        return np.zeros(0, bool)
    d = covariance.shape[-1]
    spread = np.asarray(steps, float)
    if spread.ndim < 3:
        spread = np.broadcast_to(spread, (len(odometry_poses) - 1, d))[:, :, None] ** 2 * np.eye(d)
    loops = make_loops(odometry_poses, spread, i, j, i_from_j, covariance)
    consistent = np.asarray(all_cycles(loops)) <= (CHI2_99[d] if threshold is None else threshold)
    return largest_clique(consistent & consistent.T, np.asarray(weights, float))


def make_loops(
    odometry_poses: Float[Array | np.ndarray, "N P"],
    step_covariance: Float[Array | np.ndarray, "M d d"],
    i: Int[Array | np.ndarray, " K"],
    j: Int[Array | np.ndarray, " K"],
    i_from_j: Float[Array | np.ndarray, "K P"],
    covariance: Float[Array | np.ndarray, "K d d"],
) -> Loops:
    """Prepares closures: every one is turned so that i < j, and the covariance of the path is summed up.

    Step errors are independent, so in the world frame they add up along the path: C_n = sum Ad Q Ad^T, and the
    odometry from m to n has covariance C_n - C_m.
    """
    arrays = (odometry_poses, step_covariance, i_from_j, covariance)
    if not concrete(arrays, i, j):
        dtype = jnp.result_type(float)
        traced = [jnp.asarray(x, dtype) for x in arrays]
        return _make_loops(_centred(traced[0]), traced[1], jnp.asarray(i), jnp.asarray(j), *traced[2:])
    poses, steps, measured, spread = (np.asarray(x, float) for x in arrays)
    count, rows, size = len(poses), capacity(len(poses), "rows"), capacity(len(measured), "closures")
    identity = _group(poses).identity
    found = _make_loops(
        filled(_centred(poses), rows, identity),
        filled(steps, rows - 1),
        filled(np.asarray(i, np.int32), size),
        filled(np.asarray(j, np.int32), size),
        filled(measured, size, identity),
        filled(spread, size, np.eye(spread.shape[-1])),
    )
    return _first(jax.tree.map(np.asarray, found), count, len(measured))


def _first(loops, rows, closures):
    return Loops(loops.poses[:rows], loops.walked[:rows], *(x[:closures] for x in loops[2:]))


def _centred(poses):
    place = slice(0, 2) if poses.shape[-1] == 3 else slice(4, 7)
    away = poses[:, place].mean(0, keepdims=True)
    return poses - away @ np.eye(poses.shape[-1])[place]


@jax.jit
def _make_loops(poses, steps, i, j, measured, covariance):
    lie = _group(poses)
    ad = lie.adjoint(poses[1:])
    walked = jnp.cumsum(small_matmul(small_matmul(ad, steps), ad.swapaxes(1, 2)), 0)
    back = (i > j)[:, None]
    turned = jnp.where(back, lie.inverse(measured), measured)
    covariance = jnp.where(back[:, :, None], _carry(lie, measured, covariance), covariance)
    walked = jnp.concatenate([jnp.zeros_like(walked[:1]), walked])
    return Loops(poses, walked, jnp.minimum(i, j), jnp.maximum(i, j), turned, covariance)


def _group(poses):
    return GROUPS["se2" if poses.shape[-1] == 3 else "se3"]


def _carry(lie, pose, covariance):
    ad = lie.adjoint(pose)
    return small_matmul(small_matmul(ad, covariance), ad.swapaxes(-1, -2))


def cycle(loops: Loops, a: Int[Array, "*b"], b: Int[Array, "*b"]) -> tuple[Float[Array, "*b"], Float[Array, "*b"]]:
    """Squared Mahalanobis distance of the cycle through closures a and b, and log det S / 2 of its covariance.

    Symmetric in a and b up to second order. Steps that both halves of a cycle walk through count twice.
    """
    lie = _group(loops.poses)
    poses, i, j, z, covariance = loops.poses, loops.i, loops.j, loops.i_from_j, loops.covariance

    def between(m, n):
        relative = lie.compose(lie.inverse(poses[m]), poses[n])
        spread = jnp.where((n > m)[..., None, None], 1, -1) * (loops.walked[n] - loops.walked[m])
        return relative, _carry(lie, lie.inverse(poses[n]), spread)

    j_from_l, cov_jl = between(j[a], j[b])
    k_from_i, cov_ki = between(i[b], i[a])
    tail = lie.compose(lie.inverse(z[b]), k_from_i)
    rest = lie.compose(j_from_l, tail)
    error = lie.log(lie.compose(z[a], rest))
    spread = _carry(lie, lie.inverse(rest), covariance[a])
    spread = spread + _carry(lie, lie.inverse(tail), cov_jl + covariance[b]) + cov_ki
    root = jnp.linalg.cholesky(spread)
    white = jax.lax.linalg.triangular_solve(root, error[..., None], left_side=True, lower=True)
    half = jnp.sum(jnp.log(jnp.diagonal(root, axis1=-2, axis2=-1)), -1)
    return jnp.sum(white[..., 0] ** 2, -1), half


def all_cycles(loops: Loops) -> Float[Array | np.ndarray, "K K"]:
    """The distances of all pairs."""
    if not concrete(loops):
        return _all_cycles(loops)
    count = len(loops.i)
    return np.asarray(_all_cycles(_filled(loops)))[:count, :count]


@jax.jit
def _all_cycles(loops):
    """Row by row, so that thousands of closures fit into memory."""
    every = jnp.arange(len(loops.i))
    return jax.lax.map(lambda a: cycle(loops, jnp.broadcast_to(a, every.shape), every)[0], every)


def cycles_with(
    loops: Loops, others: Int[np.ndarray, "K M"]
) -> tuple[Float[np.ndarray, "K M"], Float[np.ndarray, "K M"]]:
    """What `cycle` says of every closure with others, as many of each."""
    count, full = len(others), _filled(loops)
    distance, half = _cycles_with(full, filled(others.astype(np.int32), len(full.i)))
    return np.asarray(distance)[:count], np.asarray(half)[:count]


@jax.jit
def _cycles_with(loops, others):
    return cycle(loops, jnp.broadcast_to(jnp.arange(len(others))[:, None], others.shape), others)


def _filled(loops):
    rows, size = capacity(len(loops.poses), "rows"), capacity(len(loops.i), "closures")
    identity = _group(loops.poses).identity
    return Loops(
        poses=filled(loops.poses, rows, identity),
        walked=filled(loops.walked, rows),
        i=filled(loops.i, size),
        j=filled(loops.j, size),
        i_from_j=filled(loops.i_from_j, size, identity),
        covariance=filled(loops.covariance, size, np.eye(loops.covariance.shape[-1])),
    )


def largest_clique(
    consistent: Bool[np.ndarray, "K K"], weights: Float[np.ndarray, " K"], *, nodes: int | None = None
) -> Bool[np.ndarray, " K"]:
    """The largest clique, ties by total weight: branch and bound with greedy colouring as the bound (Tomita)."""
    k = len(weights)
    adjacent = consistent & consistent.T & ~np.eye(k, dtype=bool)
    order = np.lexsort((-weights, -adjacent.sum(1)))
    adjacent, w = adjacent[np.ix_(order, order)], weights[order].tolist()
    masks = [sum(1 << int(q) for q in np.flatnonzero(row)) for row in adjacent]
    best: tuple[int, float, list[int]] = (0, 0.0, [])
    left = min(_NODES, _WORK // max(k, 1)) if nodes is None else nodes

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

    greedy, candidates = [], (1 << k) - 1
    while candidates:
        p = (candidates & -candidates).bit_length() - 1
        greedy.append(p)
        candidates &= masks[p]
    best = (len(greedy), sum(w[p] for p in greedy), greedy)
    everyone = (1 << k) - 1
    path: list[int] = []
    stack = [(colour(everyone), everyone, 0.0)]
    while stack and left > 0:
        options, candidates, weight = stack.pop()
        if not options or (len(path) + options[-1][1], weight + options[-1][2]) <= best[:2]:
            path = path[:-1]
            continue
        left -= 1
        p = options.pop()[0]
        stack.append((options, candidates & ~(1 << p), weight))
        path = [*path, p]
        weight += w[p]
        if (len(path), weight) > best[:2]:
            best = (len(path), weight, path)
        stack.append((colour(candidates & masks[p]), candidates & masks[p], weight))
    out = np.zeros(k, bool)
    out[order[best[2]]] = True
    return out
