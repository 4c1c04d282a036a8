"""How well planar motions explain matched pixels, each by what is known of its depth.

A point at inverse depth rho in image j lies in image i at

    x(rho) = pi(P (R r + rho b)) = x(0) + d rho / (1 + e rho)

so the partner of a pixel lies on a segment from x(0), where the rotation alone puts it, to x(RHO_MAX). What is known of
the depth says where: a point of the floor has rho = -r_z / h, a depth image measures rho, and without either any place
will do. That is the epipolar constraint, with points in front of both cameras, and it becomes the full constraint of a
pure rotation as b goes to 0. Host side, NumPy; any number of motions at once.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ebjax.odometry.planar_motion import Pairs

RHO_MAX = 2.5
"""Nothing is seen nearer than its inverse, 1/m."""
RHO_SIGMA = 0.004
"""Standard deviation of a depth image's inverse depth, 1/m: that of stereo is the same at every range."""
LINE_COST = 1.0
"""What a match on a line of any length costs beside one at a point, as GRIC has it (Torr 1998)."""
WRONG_COST = 20.0
"""-2 log likelihood of a wrong match: anywhere in the image, against one within a pixel."""


@dataclass(frozen=True)
class Explained:
    """What each motion makes of each match.

    Attributes:
      residuals: x, y and measured inverse depth, each over its standard deviation.
      spread: the standard deviation of x and y, px; with `like`, that of its motions, as `floor`.
      cost: -2 log likelihood of a right match.
      floor: where the match is taken for a point of the floor.
    """

    residuals: Float[np.ndarray, "3 *h N"]
    spread: Float[np.ndarray, "*g N"]
    cost: Float[np.ndarray, "*h N"]
    floor: Bool[np.ndarray, "*g N"]


def segments(motions: Float[np.ndarray, "*h 3"], pairs: Pairs) -> tuple[np.ndarray, ...]:
    """x(0) (x, y), d (x, y), e, and depth in i over depth in j at infinity; behind camera i that is <= 0.05."""
    p, (x, y, z) = pairs.image_from_ray, pairs.rays_j.T
    p = p.astype(x.dtype)
    bx, by, theta = (motions[..., k, None].astype(x.dtype) for k in range(3))
    cos, sin = np.cos(theta), np.sin(theta)
    rx, ry = cos * x - sin * y, sin * x + cos * y
    ratio = p[2, 0] * rx + p[2, 1] * ry + p[2, 2] * z
    safe = 1 / np.maximum(ratio, 0.05)
    bend = (p[2, 0] * bx + p[2, 1] * by) * safe
    fars, slopes = [], []
    for k in (0, 1):
        far = (p[k, 0] * rx + p[k, 1] * ry + p[k, 2] * z) * safe
        fars.append(far)
        slopes.append((p[k, 0] * bx + p[k, 1] * by) * safe - bend * far)
    return (*fars, *slopes, bend, ratio)


def explain(
    motions: Float[np.ndarray, "*h 3"],
    pairs: Pairs,
    *,
    floor: bool = True,
    like: Explained | None = None,
    lines: bool = False,
) -> Explained:
    """Distances of the seen pixels from where each motion lets them lie.

    A match costs |r|^2 / sigma^2 plus 2 log(1 + L / sqrt(2 pi) sigma), L the length that its unknown depth leaves
    open: a motion that says more, and is right, wins. The floor says all, as a measured depth does.

    Args:
      motions: (bx, by, theta) of the camera.
      pairs: the matches.
      floor: whether a match may be a point of the floor, and none may lie beyond it.
      like: take what is floor, and the spread, from these: what derivatives need.
      lines: let segments go on beyond both ends. What only a end forbids is a bound, no information.
    """
    far_x, far_y, dx, dy, bend, ratio = segments(motions, pairs)
    ox, oy = pairs.pixels_i[:, 0] - far_x, pairs.pixels_i[:, 1] - far_y
    has_depth, known = pairs.has_depth, pairs.known
    # No wall is seen behind the floor. A tenth is left to noise: what lies just above the floor must not pull at it.
    least = 0.9 * known * ~has_depth if floor else np.zeros_like(known)
    length2 = dx * dx + dy * dy + 1e-20
    length = np.sqrt(length2)
    inner = (ox * dx + oy * dy) / length
    # The nearest place on the line: inner = length rho / (1 + bend rho).
    rest = length - inner * bend
    rho = np.clip(inner / np.where(rest > 0, rest, 1e-12), -1e3 if lines else least, RHO_MAX if floor else 1e3)
    at, at_known = rho / np.maximum(1 + bend * rho, 0.05), known / np.maximum(1 + bend * known, 0.05)
    wall_x, wall_y = ox - dx * at, oy - dy * at
    exact_x, exact_y = ox - dx * at_known, oy - dy * at_known
    ratio_known = np.maximum(ratio * (1 + bend * known), 0.3)
    if like is None:
        wall_spread = pairs.sigma_px * np.sqrt(1 + np.maximum(ratio * (1 + bend * rho), 0.3) ** -2)
        exact_spread = pairs.sigma_px * np.sqrt(1 + ratio_known**-3)
    else:
        wall_spread = exact_spread = like.spread
    third = np.zeros_like(rho)
    if has_depth.any():
        # An error of the depth moves the point along the segment: that much is forgiven there.
        blur = RHO_SIGMA * length / np.maximum(1 + bend * known, 0.05) ** 2
        forgiven = np.where(has_depth, 1 - exact_spread / np.sqrt(exact_spread**2 + blur**2), 0)
        forgiven = forgiven * (exact_x * dx + exact_y * dy) / length2
        exact_x, exact_y = exact_x - forgiven * dx, exact_y - forgiven * dy
        seen = np.nan_to_num(pairs.rho_i, nan=0.0)
        third = np.where(has_depth, (seen - known / ratio_known) / (RHO_SIGMA * np.sqrt(1 + ratio_known**-4)), 0)
    open_px = length * RHO_MAX / np.maximum(1 + bend * RHO_MAX, 0.05)
    # Without a floor the scale is free, and so is the length: a pure rotation says more by one number a match.
    freedom = 2 * np.log1p(open_px / (2.5 * wall_spread)) if floor else LINE_COST * (length > 1e-9)
    wall_cost = (wall_x**2 + wall_y**2) / wall_spread**2 + freedom
    exact_cost = (exact_x**2 + exact_y**2) / exact_spread**2 + third**2
    is_floor = pairs.may_be_floor & floor & (exact_cost < wall_cost) if like is None else like.floor
    exact = is_floor | has_depth
    behind = ratio <= 0.05
    spread = np.where(exact, exact_spread, wall_spread)
    pixel = np.stack([np.where(exact, exact_x, wall_x), np.where(exact, exact_y, wall_y)]) / spread
    residuals = np.concatenate([pixel, np.where(exact, third, 0)[None]])
    cost = np.where(behind, 1e6, np.where(exact, exact_cost, wall_cost))
    return Explained(residuals, spread, cost, is_floor)


def disparity(motion: Float[np.ndarray, "3"], pairs: Pairs) -> Float[np.ndarray, " N"]:
    """How far the known inverse depth moves each corner from where the rotation alone puts it, px."""
    _, _, dx, dy, bend, _ = (a[0] for a in segments(motion[None], pairs))
    return np.hypot(dx, dy) * pairs.known / np.maximum(1 + bend * pairs.known, 0.05)


def quick_score(motions: Float[np.ndarray, "H 3"], pairs: Pairs) -> Float[np.ndarray, " H"]:
    """About the score of `explain`, for thousands of motions: no spreads, no far ends, in float32."""
    single = pairs.single()
    far_x, far_y, dx, dy, bend, ratio = segments(motions, single)
    ox, oy = single.pixels_i[:, 0] - far_x, single.pixels_i[:, 1] - far_y
    known = np.where(pairs.has_depth | pairs.may_be_floor, pairs.known, np.nan).astype(np.float32)
    length2 = dx * dx + dy * dy + np.float32(1e-12)
    # Behind x(0) the nearest place is x(0) itself.
    inner = np.maximum(ox * dx + oy * dy, 0) / length2
    variance = (2 * pairs.sigma_px**2).astype(np.float32)
    wall = ((ox - dx * inner) ** 2 + (oy - dy * inner) ** 2) / variance
    wall += np.log1p(length2 * np.float32(RHO_MAX**2 / 6.0) / variance)
    at = known / np.maximum(1 + bend * known, np.float32(0.05))
    exact = ((ox - dx * at) ** 2 + (oy - dy * at) ** 2) / variance
    cost = np.fmin(wall, exact)
    return np.where(ratio > 0.05, np.minimum(cost, np.float32(WRONG_COST)), np.float32(WRONG_COST)).sum(1)


def score(cost: Float[np.ndarray, "*h N"]) -> Float[np.ndarray, "*h"]:
    """The sum of the truncated costs, MSAC's."""
    return np.minimum(cost, WRONG_COST).sum(-1)


def trust(cost: Float[np.ndarray, "*h N"]) -> Float[np.ndarray, "*h N"]:
    """Probability of each match to be right, at even odds."""
    return 1 / (1 + np.exp(np.clip((cost - WRONG_COST) / 2, -50, 50)))
