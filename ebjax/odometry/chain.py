"""A chain of poses from steps and wheels: banded Gauss-Newton on the host, and which of them the others contradict.

Truncated least squares by graduated non-convexity (Yang et al. 2020): every step and every count of the wheels is
doubted alike, so that a reset of the odometry and a step that is a tile off are both found by their neighbours.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import solveh_banded

from ebjax.geometry.planar import adjoint, between, compose, inverse, log, log_jacobian

LIMIT = 16.27
"""The 99.9 % point of chi-square with three degrees of freedom."""
GROWTH = 1.6
CARRIED_M, CARRIED_RAD = 1.0, 0.6
"""Standard deviation of a step that nothing measured."""


class Edges(NamedTuple):
    """Relative poses i_from_j between rows, their information in the right tangent, and which may be doubted."""

    i: Int[np.ndarray, " E"]
    j: Int[np.ndarray, " E"]
    measured: Float[np.ndarray, "E 3"]
    information: Float[np.ndarray, "E 3 3"]
    doubted: Bool[np.ndarray, " E"]


def residuals(edges: Edges, poses: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "E 3"]:
    """log(measured^-1 * i_from_j)."""
    return log(compose(inverse(edges.measured), between(poses[edges.i], poses[edges.j])))


def squared(edges: Edges, poses: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, " E"]:
    """Squared Mahalanobis distances."""
    r = residuals(edges, poses)
    return np.einsum("ea,eab,eb->e", r, edges.information, r)


def relax(
    edges: Edges, poses: Float[np.ndarray, "N 3"], weights: Float[np.ndarray, " E"], rounds: int = 4
) -> Float[np.ndarray, "N 3"]:
    """Gauss-Newton steps on the weighted edges, the first pose held."""
    count = len(poses)
    band = 3 * (int(np.abs(edges.i - edges.j).max(initial=1)) + 1) - 1
    for _ in range(rounds):
        r = residuals(edges, poses)
        information = edges.information * weights[:, None, None]
        # The residual moves by J (d_j - Ad(j_from_i) d_i).
        to_j = log_jacobian(r)
        to_i = -to_j @ adjoint(between(poses[edges.j], poses[edges.i]))
        by_i, by_j = (np.swapaxes(jacobian, 1, 2) @ information for jacobian in (to_i, to_j))
        blocks = ((edges.i, edges.i, by_i @ to_i), (edges.j, edges.j, by_j @ to_j), (edges.i, edges.j, by_i @ to_j))
        upper = np.zeros((band + 1, 3 * count))
        for a, b, block in blocks:
            swap = a > b
            first, second = np.where(swap, b, a), np.where(swap, a, b)
            block = np.where(swap[:, None, None], np.swapaxes(block, 1, 2), block)
            for m in range(3):
                for n in range(3):
                    row, column = 3 * first + m, 3 * second + n
                    keep = row <= column
                    np.add.at(upper, ((band + row - column)[keep], column[keep]), block[keep, m, n])
        gradient = np.zeros((count, 3))
        np.add.at(gradient, edges.i, np.einsum("eab,eb->ea", by_i, r))
        np.add.at(gradient, edges.j, np.einsum("eab,eb->ea", by_j, r))
        upper[-1, :3] += 1e12
        upper[-1] += 1e-9
        delta = -solveh_banded(upper, gradient.ravel(), check_finite=False).reshape(-1, 3)
        poses = compose(poses, delta)
        if np.abs(delta).max(initial=0) < 1e-9:
            break
    return poses


def carried(poses: Float[np.ndarray, "N 3"]) -> Edges:
    """What holds the chain together where nothing measures it: each step as it stands, hardly believed."""
    rows = np.arange(len(poses) - 1)
    information = np.diag([CARRIED_M**-2, CARRIED_M**-2, CARRIED_RAD**-2])
    return Edges(rows, rows + 1, between(poses[:-1], poses[1:]), np.tile(information, (len(rows), 1, 1)), rows < 0)


def settle_chain(
    edges: Edges, poses: Float[np.ndarray, "N 3"], held: Edges | None = None
) -> tuple[Float[np.ndarray, "N 3"], Bool[np.ndarray, " E"]]:
    """The poses that most edges agree on, and which edges count there.

    Args:
      edges: steps and wheels.
      poses: the start.
      held: what holds the chain together; None: as the start has it.
    """
    held = carried(poses) if held is None else held
    every = Edges(*(np.concatenate([a, b]) for a, b in zip(edges, held, strict=True)))
    doubted = every.doubted
    weights = np.ones(len(every.i))
    poses = relax(every, poses, weights)
    worst = float(squared(every, poses)[doubted].max(initial=0))
    softness = LIMIT / max(2 * worst - LIMIT, 1e-12) if worst > LIMIT else np.inf
    while softness < 1e3:
        s = squared(every, poses)
        between_limits = np.sqrt(LIMIT * softness * (softness + 1) / np.maximum(s, 1e-300)) - softness
        weights = np.where(doubted, np.clip(between_limits, 0, 1), 1.0)
        poses = relax(every, poses, weights, 2)
        softness *= GROWTH
    for _ in range(10):
        new = np.where(doubted, squared(every, poses) <= LIMIT, True).astype(float)
        poses = relax(every, poses, new)
        if np.array_equal(new, weights):
            break
        weights = new
    counts = squared(every, poses) <= LIMIT
    return poses, (counts | ~doubted)[: len(edges.i)]


def carried_on(
    moved: Float[np.ndarray, "M 3"], known: Bool[np.ndarray, " M"], times: Float[np.ndarray, " N"]
) -> Float[np.ndarray, "M 3"]:
    """Steps of which some are not known: these go on at the speed of those around them.

    Args:
      moved: earlier_from_later of each of the M = N - 1 steps.
      known: which hold; the others may be anything. Where none does, all stay as they are.
      times: of the N poses, s.
    """
    if not known.any() or known.all():
        return moved
    seconds, middle = np.diff(times), (times[1:] + times[:-1]) / 2
    speed = moved / seconds[:, None]
    filled = np.stack([np.interp(middle, middle[known], speed[known, axis]) for axis in range(3)], 1)
    return np.where(known[:, None], moved, filled * seconds[:, None])
