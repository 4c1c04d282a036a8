"""The best of many hypotheses of a planar motion, refined on all matches at once, and its covariance.

Host side, NumPy.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ebjax.odometry.planar_motion import Pairs
from ebjax.odometry.planar_motion_cost import WRONG_COST, Explained, explain, quick_score, score, trust
from ebjax.odometry.planar_motion_search import epipolar_pairs, floor_votes, rigid_pairs, turn_peaks

STEPS = np.array([1e-4, 1e-4, 2e-5])
RIDGE = np.array([25.0, 25.0, 100.0])
"""Information that keeps what no match tells: 0.2 m, 0.1 rad."""
HELD = 1e12
"""Information that holds a number."""
FREEDOM = 3.0
"""Degrees of freedom of Student's distribution: most corners lie far better than the worst."""
POLISH = 4
SETS = 125
SUBSET = 100
"""The search looks at so many of the best matches; the last refinement at all of them."""
CLEAR = 0.35
"""Share of the cost of wrong matches below which a motion is taken for found."""
PROFILE_RAD = np.radians([0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0, 1.25, 1.5, 1.8])
LEVELS_M = np.array([0.0, 0.02, 0.06, 0.2, 0.6])
"""Lengths of b that are tried where only its direction is known."""


@dataclass(frozen=True)
class Fit:
    """Refined motions (bx, by, theta) of the camera, scores (smaller is better), what they make of matches."""

    motions: Float[np.ndarray, "C 3"]
    scores: Float[np.ndarray, " C"]
    explained: Explained

    def sorted(self) -> "Fit":
        """Best first."""
        order = np.argsort(self.scores, kind="stable")
        rows = {n: getattr(self.explained, n)[..., order, :] for n in Explained.__dataclass_fields__}
        return Fit(self.motions[order], self.scores[order], Explained(**rows))


def jacobian(motions: Float[np.ndarray, "C 3"], pairs: Pairs, at: Explained, **options) -> Float[np.ndarray, "3 3 C N"]:
    """Derivatives of the residuals (second axis) by bx, by, theta (first axis)."""
    ahead = explain(motions + np.diag(STEPS)[:, None, :], pairs, like=at, **options).residuals
    return (ahead.swapaxes(0, 1) - at.residuals) / STEPS[:, None, None, None]


def normal_equations(
    motions: Float[np.ndarray, "C 3"], pairs: Pairs, at: Explained, weights: Float[np.ndarray, "C N"], **options
) -> tuple[Float[np.ndarray, "C 3 3"], Float[np.ndarray, "C 3"]]:
    """Gauss-Newton's matrix J^T W J and vector J^T W r."""
    count, n = at.cost.shape
    root = np.sqrt(weights)
    j = (jacobian(motions, pairs, at, **options) * root).transpose(2, 0, 1, 3).reshape(count, 3, 3 * n)
    r = (at.residuals * root).transpose(1, 0, 2).reshape(count, 3 * n)
    return j @ j.swapaxes(1, 2), (j @ r[..., None])[..., 0]


def refine(
    motions: Float[np.ndarray, "C 3"], pairs: Pairs, iterations: int, *, floor: bool = True, turns: bool = True
) -> Fit:
    """Gauss-Newton from every motion, side by side, weighted by `trust`; each keeps the best it came by.

    Args:
      motions: where to start.
      pairs: the matches.
      iterations: how many.
      floor: whether a match may be a point of the floor.
      turns: whether theta may change.
    """
    ridge = RIDGE + HELD * np.array([0.0, 0.0, not turns])
    # Without a floor a pure rotation is another model, not a small b.
    rests = np.all(motions[:, :2] == 0, axis=1) & (not floor)
    ridge = ridge + HELD * rests[:, None] * np.array([1.0, 1.0, 0.0])
    at = explain(motions, pairs, floor=floor)
    best, best_score = motions, score(at.cost)
    for _ in range(iterations):
        hessian, gradient = normal_equations(motions, pairs, at, trust(at.cost), floor=floor)
        step = np.linalg.solve(hessian + ridge[:, None] * np.eye(3), gradient[..., None])[..., 0]
        step[rests, :2] = 0
        step[:, 2] *= turns
        step *= np.minimum(1, 0.2 / np.maximum(np.abs(step).max(1), 1e-9))[:, None]
        motions = motions - step
        at = explain(motions, pairs, floor=floor)
        new = score(at.cost)
        better = new < best_score
        best, best_score = np.where(better[:, None], motions, best), np.where(better, new, best_score)
    return Fit(best, best_score, at if np.array_equal(best, motions) else explain(best, pairs, floor=floor))


def distinct(
    motions: Float[np.ndarray, "H 3"],
    scores: Float[np.ndarray, " H"],
    count: int,
    apart: tuple[float, float, float] = (0.1, 0.1, 0.01),
) -> Int[np.ndarray, " K"]:
    """Rows of the best motions, best first, one for each cell of a lattice `apart` (m, m, rad) wide."""
    order = np.argsort(scores, kind="stable")[: 50 * count]
    cells = np.round(motions[order] / np.array(apart)).astype(np.int64)
    return order[np.sort(np.unique(cells, axis=0, return_index=True)[1])[:count]]


def search(pairs: Pairs, start: Float[np.ndarray, "K 3"], *, floor: bool = True, seed: int = 0) -> Fit:
    """The best motions that differ, best first.

    Args:
      pairs: the matches, the surest first.
      start: more hypotheses, (bx, by, theta).
      floor: whether a match may be a point of the floor.
      seed: of the random sets.
    """
    random = np.random.default_rng(seed)
    some = pairs.take(np.arange(min(len(pairs), SUBSET)))
    if not floor:
        some = some.without_floor()
    epipolar = epipolar_pairs(some, SETS, random) * [0.3, 0.3, 1]
    motions = np.concatenate([start, turn_peaks(some, 3), epipolar, rigid_pairs(some, SETS, random)])
    fit = refine(motions[distinct(motions, quick_score(motions, some), 8)], some, 3, floor=floor)
    # What explains most matches at once needs no further hypotheses.
    if fit.scores.min() > CLEAR * WRONG_COST * len(some):
        more = [fit.motions]
        for motion in fit.motions[np.argsort(fit.scores)[:4]]:
            way = motion[:2] / max(np.linalg.norm(motion[:2]), 1e-9)
            more.append(np.column_stack([LEVELS_M[:, None] * way, np.full(len(LEVELS_M), motion[2])]))
            more.append(floor_votes(motion[2], some, 8))
        motions = np.concatenate(more)
        scores = score(explain(motions, some, floor=floor).cost)
        fit = refine(motions[distinct(motions, scores, 6, (0.02, 0.02, 0.01))], some, 3, floor=floor)
    fit = refine(fit.motions[distinct(fit.motions, fit.scores, 3)], pairs, 2, floor=floor)
    return fit.sorted()


def turn_width(motion: Float[np.ndarray, "3"], pairs: Pairs) -> float:
    """How far theta may turn, b following, until the score is worse by two wrong matches, rad; no floor.

    A turn and a sideways move look alike where all corners are close together, and then a few wrong matches decide:
    what the noise of the right ones says of theta is too good.
    """
    near = score(explain(motion[None], pairs, floor=False).cost)[0] + 2 * WRONG_COST
    start = motion if (motion[:2] != 0).any() else motion + np.array([0, 1e-3, 0])
    motions, width = np.stack([start, start]), PROFILE_RAD[0]
    for offset in PROFILE_RAD:
        motions = np.column_stack([motions[:, :2], motion[2] + np.array([-offset, offset])])
        fit = refine(motions, pairs, 3, floor=False, turns=False)
        motions = fit.motions
        width = offset if fit.scores.min() < near else width
    return float(width)


def polish(
    motion: Float[np.ndarray, "3"],
    pairs: Pairs,
    prior: Float[np.ndarray, "3"],
    information: Float[np.ndarray, "3 3"],
    *,
    floor: bool = True,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """The last refinement: Student's weights, the noise of the corners estimated with the motion (Lange et al. 1989).

    Without a floor no match tells the length of b, which is held; b = 0, a pure rotation, stays so.

    Args:
      motion: (bx, by, theta), nearly right.
      pairs: all matches.
      prior: (bx, by, theta), for what no match tells.
      information: of the prior, in these numbers.
      floor: whether a match may be a point of the floor.

    Returns:
      The motion, and its covariance by the noise of its own residuals.
    """
    moved = bool((motion[:2] != 0).any())
    if not floor:
        way = motion * [1, 1, 0] / max(np.linalg.norm(motion[:2]), 1e-9)
        held = np.outer(way, way) if moved else np.diag([1.0, 1.0, 0.0])
        prior = prior + held @ (motion - prior)
        information = information + HELD * held
    motions, variance = motion[None], 1.0
    at = explain(motions, pairs, floor=floor)
    keep = at.cost < WRONG_COST
    freedom = np.where(pairs.has_depth, 3, np.where(at.floor, 2, 1)) * keep
    for _ in range(POLISH):
        squared = (at.residuals**2).sum(0) / variance
        weights = keep * (FREEDOM + freedom) / (FREEDOM + squared)
        hessian, gradient = normal_equations(motions, pairs, at, weights / variance, floor=floor)
        gradient = gradient + (motions - prior) @ information
        motions = motions - np.linalg.solve(hessian + information, gradient[..., None])[..., 0]
        variance = max(variance * (weights * squared).sum() / max(freedom.sum() - 3, 1), 0.01)
        at = explain(motions, pairs, floor=floor, like=at)
    if not (floor or moved):
        motions[:, :2] = 0
    # Fisher's information of Student's location is (v + d) / (v + d + 2) of the Gauss-Newton matrix at unit weight.
    weights = keep * (FREEDOM + freedom) / (FREEDOM + freedom + 2) / variance
    if not floor:
        at = explain(motions, pairs, floor=floor, like=at, lines=moved)
    unit, _ = normal_equations(motions, pairs, at, weights, floor=floor, lines=moved and not floor)
    return motions[0], np.linalg.inv(unit[0] + information)
