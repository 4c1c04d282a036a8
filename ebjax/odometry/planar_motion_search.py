"""Hypotheses of a planar motion from matched rays: pure rotations, epipolar pairs, votes of the floor, depth pairs.

All of them are (bx, by, theta) as in `planar_motion`, many and cheap: what is right is for a score to say. Host side,
NumPy.
"""

import numpy as np
from jaxtyping import Float

from ebjax.odometry.planar_motion import Pairs

TURN_LIMIT_RAD = 1.3
TURN_STEP_RAD = 0.02
TURN_WINDOW_RAD = 0.004


def turn_peaks(pairs: Pairs, count: int) -> Float[np.ndarray, "K 3"]:
    """Pure rotations: the most frequent differences of bearing, theta = atan2(r_i) - atan2(r_j)."""
    bearing_i, bearing_j = (np.arctan2(r[:, 1], r[:, 0]) for r in (pairs.rays_i, pairs.rays_j))
    turn = np.sort((bearing_i - bearing_j + np.pi) % (2 * np.pi) - np.pi)
    turn = turn[np.abs(turn) < TURN_LIMIT_RAD]
    low = np.searchsorted(turn, turn - TURN_WINDOW_RAD)
    high = np.searchsorted(turn, turn + TURN_WINDOW_RAD)
    votes = high - low
    peaks: list[list[float]] = []
    while len(peaks) < count and len(votes) and votes.max() > 0:
        best = int(votes.argmax())
        peaks.append([0.0, 0.0, turn[low[best] : high[best]].mean()])
        votes = np.where(np.abs(turn - turn[best]) < 3 * TURN_WINDOW_RAD, 0, votes)
    return np.array(peaks).reshape(-1, 3)


def _normals(pairs: Pairs) -> Float[np.ndarray, "3 N 2"]:
    """The epipolar constraint g . b = 0 with g = g0 + cos(theta) g1 + sin(theta) g2, from r_i . (b x R r_j) = 0."""
    (ax, ay, az), (rx, ry, rz) = pairs.rays_i.T, pairs.rays_j.T
    zero = np.stack([-ay * rz, ax * rz], -1)
    cosine = np.stack([az * ry, -az * rx], -1)
    sine = np.stack([az * rx, az * ry], -1)
    return np.stack([zero, cosine, sine])


def epipolar_pairs(pairs: Pairs, sets: int, random: np.random.Generator) -> Float[np.ndarray, "H 3"]:
    """Motions of unit length through two matches each, b both ways.

    The two constraints g . b = 0 have a common b where det[g, g'](theta) = 0, a quadratic form of (1, cos, sin): its
    roots are found on a grid of angles.
    """
    n = len(pairs)
    if n < 2:
        return np.zeros((0, 3))
    one = random.integers(0, n, sets)
    two = (one + random.integers(1, n, sets)) % n
    theta = np.arange(-TURN_LIMIT_RAD, TURN_LIMIT_RAD, TURN_STEP_RAD)
    basis = np.stack([np.ones_like(theta), np.cos(theta), np.sin(theta)])
    normals = _normals(pairs)
    g, h = normals[:, one], normals[:, two]
    form = g[:, None, :, 0] * h[None, :, :, 1] - g[:, None, :, 1] * h[None, :, :, 0]
    determinant = np.einsum("abs,at,bt->st", form, basis, basis, optimize=True)
    rows, columns = np.nonzero(determinant[:, :-1] * determinant[:, 1:] < 0)
    left, right = determinant[rows, columns], determinant[rows, columns + 1]
    root = theta[columns] + TURN_STEP_RAD * left / (left - right)
    at_root = np.stack([np.ones_like(root), np.cos(root), np.sin(root)])
    normal = np.stack([np.einsum("as,asc->sc", at_root, k[:, rows]) for k in (g, h)])
    longer = (normal**2).sum(-1).argmax(0)
    normal = normal[longer, np.arange(len(rows))]
    b = np.column_stack([-normal[:, 1], normal[:, 0]]) / np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
    return np.concatenate([np.column_stack([b, root]), np.column_stack([-b, root])])


def floor_votes(theta: float, pairs: Pairs, count: int) -> Float[np.ndarray, "K 3"]:
    """Motions of one angle for which most corners of the floor vote: b = f_i - R f_j, f a floor point seen from above.

    A vote is as wide as a pixel's error on the floor, (h^2 + d^2) / (h f) a pixel; those that most others support come
    first.
    """
    rows = np.flatnonzero(~np.isnan(pairs.rho_floor))
    if not len(rows):
        return np.zeros((0, 3))
    one, two = (r[rows] for r in (pairs.rays_i, pairs.rays_j))
    foot_i, foot_j = (-r[:, :2] * (pairs.height_m / r[:, 2:]) for r in (one, two))
    c, s = np.cos(theta), np.sin(theta)
    vote = foot_i - foot_j @ np.array([[c, s], [-s, c]])
    squared = np.stack([(f**2).sum(1) for f in (foot_i, foot_j)])
    focal = np.linalg.norm(pairs.image_from_ray[0])
    sigma = (pairs.height_m**2 + squared) / (pairs.height_m * focal) * pairs.sigma_px[rows]
    variance = (sigma**2).sum(0)
    spread = variance[:, None] + variance[None, :]
    support = np.exp(-((vote[:, None] - vote[None]) ** 2).sum(-1) / (2 * spread)).sum(1)
    best = np.argsort(-support)[:count]
    return np.column_stack([vote[best], np.full(len(best), theta)])


def rigid_pairs(pairs: Pairs, sets: int, random: np.random.Generator) -> Float[np.ndarray, "H 3"]:
    """Motions through two matches each whose places are known, by depth or on the floor: rigid, in the plane."""
    rho_j = np.where(np.isnan(pairs.rho_j), pairs.rho_floor, pairs.rho_j)
    rho_i = np.where(np.isnan(pairs.rho_i), -pairs.rays_i[:, 2] / pairs.height_m, pairs.rho_i)
    rows = np.flatnonzero(~np.isnan(rho_j))
    if len(rows) < 2:
        return np.zeros((0, 3))
    # Near corners are the exact ones.
    nearness = rho_j[rows] ** 2
    draws = random.choice(rows, (sets, 2), p=nearness / nearness.sum())
    one, two = draws[draws[:, 0] != draws[:, 1]].T
    p_i, p_j = pairs.rays_i[:, :2] / rho_i[:, None], pairs.rays_j[:, :2] / rho_j[:, None]
    d_i, d_j = p_i[two] - p_i[one], p_j[two] - p_j[one]
    theta = np.arctan2(d_j[:, 0] * d_i[:, 1] - d_j[:, 1] * d_i[:, 0], (d_i * d_j).sum(1))
    c, s = np.cos(theta), np.sin(theta)
    middle_i, middle_j = (p_i[one] + p_i[two]) / 2, (p_j[one] + p_j[two]) / 2
    turned = np.column_stack([c * middle_j[:, 0] - s * middle_j[:, 1], s * middle_j[:, 0] + c * middle_j[:, 1]])
    # A short base turns by anything.
    good = (np.abs(theta) < TURN_LIMIT_RAD) & (np.linalg.norm(d_j, axis=1) > 0.1)
    return np.column_stack([middle_i - turned, theta])[good]
