"""How far odometry may err between two keyframes, and what that says of a candidate: worth verifying, contradicted."""

import numpy as np
from jaxtyping import Bool, Float, Int

from ebjax.geometry.planar import wrapped


def drift_sigma_m(
    odom_from_base: Float[np.ndarray, "N 3"],
    steps: Float[np.ndarray, "M 3 3"],
    i: Int[np.ndarray, " K"],
    j: Int[np.ndarray, " K"],
) -> Float[np.ndarray, " K"]:
    """Standard deviation (radial, both axes) of where odometry puts frame j seen from the later frame i, m.

    Translation errors add up, and the heading error of every step between swings all the path behind it:
    sum (sigma_x^2 + sigma_y^2) + sum sigma_theta^2 |p_j - p_step|^2, by running sums, whatever the number of pairs.

    Args:
      odom_from_base: the path: x, y (m), heading (rad).
      steps: covariance of each of its steps, right tangent.
      i: rows of the later frames.
      j: rows of the earlier ones.
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
    i: Int[np.ndarray, " K"],
    j: Int[np.ndarray, " K"],
    i_from_j: Float[np.ndarray, "K 3"],
    covariance: Float[np.ndarray, "K 3 3"],
    odom_from_base: Float[np.ndarray, "N 3"],
    steps: Float[np.ndarray, "M 3 3"],
) -> Float[np.ndarray, " K"]:
    """How many standard deviations of the odometry between them the measured i_from_j is away from it, in position."""
    claimed = on_floor(odom_from_base[i], i_from_j[:, :2])
    gap = np.linalg.norm(claimed - odom_from_base[j, :2], axis=1)
    own = np.trace(covariance[:, :2, :2], axis1=1, axis2=2)
    return gap / np.hypot(drift_sigma_m(odom_from_base, steps, i, j), np.sqrt(np.maximum(own, 1e-12)))


def on_floor(poses: Float[np.ndarray, "K 3"], points: Float[np.ndarray, "K 2"]) -> Float[np.ndarray, "K 2"]:
    """Points given in base, in the world."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = points[:, 0], points[:, 1]
    return poses[:, :2] + np.stack([c * x - s * y, s * x + c * y], 1)


def plausible(
    i: Int[np.ndarray, " K"],
    j: Int[np.ndarray, " K"],
    opposing: Bool[np.ndarray, " K"] | None,
    odom_from_base: Float[np.ndarray, "N 3"],
    view_centre_m: Float[np.ndarray, "2"],
    view_extent_m: float,
    steps: Float[np.ndarray, "M 3 3"],
    sigmas: float,
) -> Bool[np.ndarray, " K"]:
    """Pairs of frames whose floor views can overlap, and face as is claimed, by an odometry that errs no more.

    A pair faces each other where the headings are nearer to half a turn apart than to none. Says what is worth
    verifying on a floor that repeats; it does not touch the ranking. Only odometry is asked: a gate of closures that
    are believed would confirm a wrong one.

    Args:
      i: rows of the later frames.
      j: rows of the earlier ones.
      opposing: whether the two are claimed to face each other; None: that does not matter.
      odom_from_base: the path: x, y (m), heading (rad).
      view_centre_m: of the floor view, in base.
      view_extent_m: how far apart the centres of two views that overlap are at most.
      steps: covariance of each step of the path, right tangent.
      sigmas: standard deviations that odometry may err by.
    """
    centre_i, centre_j = (on_floor(odom_from_base[k], np.broadcast_to(view_centre_m, (len(k), 2))) for k in (i, j))
    gap = np.linalg.norm(centre_i - centre_j, axis=1)
    near = gap <= view_extent_m + sigmas * drift_sigma_m(odom_from_base, steps, i, j)
    if opposing is None:
        return near
    turned = np.abs(wrapped(odom_from_base[i, 2] - odom_from_base[j, 2] - np.pi * opposing))
    turning = np.concatenate([np.zeros(1), np.cumsum(steps[:, 2, 2])])
    return near & (turned <= np.pi / 2 + sigmas * np.sqrt(np.maximum(turning[i] - turning[j], 0)))
