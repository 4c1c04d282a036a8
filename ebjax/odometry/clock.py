"""How late the images are against the odometry, from turning rates: where the floor turns, the wheels must turn too."""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from ebjax.geometry.planar import wrapped

REACH_S, GRID_S = 1.0, 0.02
MAX_SIGMA_S = 0.03
SIGNIFICANT = 3.0
"""An offset within so many standard deviations of zero stays zero."""
LEAST_GAIN = 0.5
"""Where the wheels seem to count turns with a smaller gain, they do not count the same turns."""
TOO_LITTLE = "turns too little or too evenly to tell: stays 0"


@dataclasses.dataclass(frozen=True)
class TimeOffset:
    """What is added to the images' stamps, s, how well that is known, and how it was settled, in words."""

    offset_s: float = 0.0
    sigma_s: float = float("inf")
    why: str = "not estimated"


def estimate_offset(
    turned: Float[np.ndarray, " K"],
    sigma: Float[np.ndarray, " K"],
    heading_at: Callable[[float], Float[np.ndarray, "K 2"]],
) -> TimeOffset:
    """The offset under which the wheels turn when the images do, with one gain and one bias of the wheels free.

    Args:
      turned: between two frames each, by the images, rad.
      sigma: of each, with what wheels may err in one step, rad.
      heading_at: (offset s) -> the wheels' headings at both frames of each, rad; NaN where there is no odometry.
    """
    if len(turned) < 20:
        return TimeOffset(why="too few steps to tell")
    grid = np.arange(-REACH_S, REACH_S + GRID_S / 2, GRID_S)
    costs = np.array([_cost(turned, sigma, heading_at(float(o))) for o in grid])
    best = int(np.argmin(costs[:, 0]))
    if np.ptp(costs[:, 0]) < SIGNIFICANT**2:
        return TimeOffset(why=TOO_LITTLE)
    if best in (0, len(grid) - 1):
        return TimeOffset(why=f"no offset within {REACH_S:g} s fits")
    step = GRID_S / 2
    offset = float(grid[best])
    for _ in range(2):  # the vertex of the parabola through three costs, twice
        low, middle, high = (_cost(turned, sigma, heading_at(offset + d))[0] for d in (-step, 0.0, step))
        bend = low - 2 * middle + high
        offset += float(np.clip(0.5 * step * (low - high) / bend, -step, step)) if bend > 0 else 0.0
    # The curvature over the grid's width, not over a step of it: between samples of the odometry costs have kinks.
    wide = 5 * GRID_S
    before, here, after = (_cost(turned, sigma, heading_at(offset + d)) for d in (-wide, 0.0, wide))
    if here[2] < LEAST_GAIN:
        return TimeOffset(why=f"no offset within {REACH_S:g} s fits")
    bend = (before[0] - 2 * here[0] + after[0]) / wide**2
    deviation = float(np.sqrt(2 * here[1] / bend)) if bend > 0 else float("inf")
    if deviation > MAX_SIGMA_S:
        return TimeOffset(0.0, deviation, TOO_LITTLE)
    if abs(offset) < max(SIGNIFICANT * deviation, GRID_S):
        return TimeOffset(0.0, deviation, "images and odometry agree")
    return TimeOffset(offset, deviation, "the turning rates of images and odometry fit then")


def _cost(turned, sigma, headings) -> tuple[float, float, float]:
    """Robust cost with gain and bias free, the variance factor of what is left, and the gain."""
    counted = wrapped(headings[:, 1] - headings[:, 0])
    known = np.isfinite(counted)
    design = np.stack([np.where(known, counted, 0.0), np.ones(len(turned))], 1)
    weight = np.where(known, 1.0, 0.0) / sigma**2
    answer = np.array([1.0, 0.0])
    prior = np.diag([10.0**2, np.radians(0.5) ** -2.0])
    for _ in range(8):
        residual = (turned - design @ answer) / sigma
        robust = weight / (1 + residual**2 / 9)
        system = (design * robust[:, None]).T @ design + prior
        answer = np.linalg.solve(system, (design * robust[:, None]).T @ turned + prior @ [1.0, 0.0])
    residual = np.where(known, (turned - design @ answer) / sigma, 0.0)
    cost = float(np.sum(9 * np.log1p(residual**2 / 9)) / max(known.mean(), 1e-3))
    return cost, max(float(np.median(np.abs(residual)) / 0.6745) ** 2, 0.01), float(answer[0])
