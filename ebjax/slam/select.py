"""Which measured candidates become loop closures, and why the others do not.

In order: enough agreeing matches; a measurement that is certain enough; agreement with the odometry walked in between;
the best of each stretch of path; the largest set that agrees with itself (pairwise consistency); the best `top` spread
along the path. Every candidate leaves with one reason.
"""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int

from ebjax.posegraph.consistency import consistent_set

KEPT = "kept"
THINNED = "a better closure is near on the path"


@dataclasses.dataclass(frozen=True)
class SelectConfig:
    """When a measured candidate is believed."""

    min_inliers: int = 20
    """Matches that agree on one motion, at least."""
    min_inlier_ratio: float = 0.4
    """Share of the matches that agree, at least: repeated tiles make many agree on a wrong motion, but not most."""
    max_sigma_m: float = 0.03
    """Largest standard deviation of the measured position, m."""
    max_sigma_deg: float = 0.5
    """Largest standard deviation of the measured heading, degrees."""
    odometry_sigmas: float = 4.0
    """How far a closure may contradict the odometry between its ends, in that odometry's standard deviations."""
    min_agreeing: int = 2
    """Closures of so many different views must agree with each other, or none is kept: one view may be an alias."""
    spacing_m: float = 0.4
    """One closure at most for so much path, the one with most agreeing matches."""
    top: int = 0
    """Keep only so many closures, spread along the path, as the paper's 20; 0 keeps all."""


@dataclasses.dataclass(frozen=True)
class Measured:
    """Measured candidates, one a row: i > j, direction, distance of the descriptors, matches, motion."""

    i: Int[np.ndarray, " K"]
    j: Int[np.ndarray, " K"]
    opposing: Bool[np.ndarray, " K"]
    distance: Float[np.ndarray, " K"]
    inliers: Int[np.ndarray, " K"]
    total: Int[np.ndarray, " K"]
    i_from_j: Float[np.ndarray, "K 3"]
    covariance: Float[np.ndarray, "K 3 3"]


def select(
    candidates: Measured,
    odom_from_base: Float[np.ndarray, "N 3"],
    steps: Float[np.ndarray, "M 3 3"],
    config: SelectConfig,
) -> list[str]:
    """Returns the reason of every candidate: "kept", or why it was left out.

    Args:
      candidates: rows i, j of the path.
      odom_from_base: the path: x, y (m), heading (rad).
      steps: covariance of each of its steps, right tangent.
      config: see there.
    """
    count = len(candidates.i)
    reasons = np.full(count, "", object)

    def reject(rows, why):
        for k in np.flatnonzero(rows):
            if not reasons[k]:
                reasons[k] = why(k) if callable(why) else why

    ratio = candidates.inliers / np.maximum(candidates.total, 1)
    reject(
        candidates.inliers < config.min_inliers,
        lambda k: f"{candidates.inliers[k]} inliers, fewer than {config.min_inliers}",
    )
    reject(
        ratio < config.min_inlier_ratio,
        lambda k: f"inlier ratio {ratio[k]:.2f}, below {config.min_inlier_ratio:g}",
    )
    sigma = np.sqrt(np.maximum(np.diagonal(candidates.covariance, axis1=1, axis2=2), 0))
    reject(~np.isfinite(candidates.i_from_j).all(1) | ~np.isfinite(sigma).all(1), "no measurement: too little depth")
    reject(
        (sigma[:, :2].max(1, initial=0) > config.max_sigma_m) | (np.degrees(sigma[:, 2]) > config.max_sigma_deg),
        lambda k: f"uncertain: {sigma[k, :2].max():.3f} m, {np.degrees(sigma[k, 2]):.2f} deg",
    )
    contradiction = odometry_distance(candidates, odom_from_base, steps)
    reject(
        contradiction > config.odometry_sigmas,
        lambda k: f"contradicts odometry by {contradiction[k]:.1f} sigma",
    )
    alive = np.flatnonzero(reasons == "")
    # Thinned out before the exact search: neighbours on the path say the same thing, and the search grows fast.
    travelled = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(odom_from_base[:, :2], axis=0), axis=1))])
    quality = candidates.inliers * ratio
    chosen = best_per_stretch(travelled[candidates.i[alive]], quality[alive], config.spacing_m)
    reject(np.isin(np.arange(count), alive[~chosen]), THINNED)
    alive = alive[chosen]
    agreed = consistent_set(
        odom_from_base,
        steps,
        candidates.i[alive],
        candidates.j[alive],
        candidates.i_from_j[alive],
        candidates.covariance[alive],
        quality[alive].astype(float),
    )
    reject(np.isin(np.arange(count), alive[~agreed]), "contradicts the other closures")
    alive = alive[agreed]
    if min(len(np.unique(candidates.i[alive])), len(np.unique(candidates.j[alive]))) < config.min_agreeing:
        reject(np.isin(np.arange(count), alive), "no other closure supports it")
        alive = alive[:0]
    if config.top and len(alive) > config.top:
        spread = spread_along(travelled[candidates.i[alive]], quality[alive], config.top)
        reject(np.isin(np.arange(count), alive[~spread]), f"not among the best {config.top} spread along the path")
        alive = alive[spread]
    reasons[alive] = KEPT
    return [str(reason) for reason in reasons]


def drift_sigma_m(
    odom_from_base: Float[np.ndarray, "N 3"],
    steps: Float[np.ndarray, "M 3 3"],
    i: Int[np.ndarray, " K"],
    j: Int[np.ndarray, " K"],
) -> Float[np.ndarray, " K"]:
    """Standard deviation (radial, both axes) of where odometry puts frame j seen from the later frame i, m.

    Translation errors add up, and the heading error of every step between swings all the path behind it:
    sum (sigma_x^2 + sigma_y^2) + sum sigma_theta^2 |p_j - p_step|^2, by running sums, whatever the number of pairs.
    """
    end = odom_from_base[1:, :2]
    turn = steps[:, 2, 2]
    terms = np.concatenate(
        [
            (steps[:, 0, 0] + steps[:, 1, 1])[:, None],
            turn[:, None],
            turn[:, None] * end,
            turn[:, None] * np.sum(end**2, 1)[:, None],
        ],
        1,
    )
    sums = np.concatenate([np.zeros((1, 5)), np.cumsum(terms, 0)])
    total = sums[i] - sums[j]
    place = odom_from_base[j, :2]
    swing = total[:, 1] * np.sum(place**2, 1) - 2 * np.sum(total[:, 2:4] * place, 1) + total[:, 4]
    return np.sqrt(np.maximum(total[:, 0] + np.maximum(swing, 0), 0))


def odometry_distance(
    candidates: Measured, odom_from_base: Float[np.ndarray, "N 3"], steps: Float[np.ndarray, "M 3 3"]
) -> Float[np.ndarray, " K"]:
    """How many standard deviations of the odometry between them the measured i_from_j is away from it, in position."""
    i, j = candidates.i, candidates.j
    claimed = on_floor(odom_from_base[i], candidates.i_from_j[:, :2])
    gap = np.linalg.norm(claimed - odom_from_base[j, :2], axis=1)
    own = np.trace(candidates.covariance[:, :2, :2], axis1=1, axis2=2)
    return gap / np.hypot(drift_sigma_m(odom_from_base, steps, i, j), np.sqrt(np.maximum(own, 1e-12)))


def on_floor(poses: Float[np.ndarray, "K 3"], points: Float[np.ndarray, "K 2"]) -> Float[np.ndarray, "K 2"]:
    """Points given in base, in the world."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = points[:, 0], points[:, 1]
    return poses[:, :2] + np.stack([c * x - s * y, s * x + c * y], 1)


def plausible(
    i: Int[np.ndarray, "N K"],
    j: Int[np.ndarray, "N K"],
    odom_from_base: Float[np.ndarray, "F 3"],
    view_centre_m: Float[np.ndarray, "2"],
    view_extent_m: float,
    steps: Float[np.ndarray, "M 3 3"],
    sigmas: float,
) -> Bool[np.ndarray, "N K"]:
    """Pairs of frames whose floor views can overlap if odometry errs by so many standard deviations at most.

    Says what is worth verifying on a floor that repeats; it does not touch the ranking.
    """
    centre = on_floor(odom_from_base, np.broadcast_to(view_centre_m, (len(odom_from_base), 2)))
    gap = np.linalg.norm(centre[i.ravel()] - centre[j.ravel()], axis=1)
    drift = drift_sigma_m(odom_from_base, steps, i.ravel(), j.ravel())
    return (gap <= view_extent_m + sigmas * drift).reshape(i.shape)


def best_per_stretch(
    place: Float[np.ndarray, " K"], quality: Float[np.ndarray, " K"], spacing: float
) -> Bool[np.ndarray, " K"]:
    """Greedy: the best first, then every next one at least `spacing` from all chosen."""
    chosen = np.zeros(len(place), bool)
    for k in np.argsort(-quality, kind="stable"):
        if not (np.abs(place[chosen] - place[k]) < spacing).any():
            chosen[k] = True
    return chosen


def spread_along(place: Float[np.ndarray, " K"], quality: Float[np.ndarray, " K"], top: int) -> Bool[np.ndarray, " K"]:
    """The best of each of `top` equal stretches of path, the free places filled with the best that are left."""
    edges = np.linspace(place.min(), place.max() + 1e-9, top + 1)
    stretch = np.searchsorted(edges, place, side="right") - 1
    chosen = np.zeros(len(place), bool)
    order = np.argsort(-quality, kind="stable")
    for k in order:
        chosen[k] = not chosen[stretch == stretch[k]].any()
    for k in order:
        if chosen.sum() >= top:
            break
        chosen[k] = True
    return chosen
