"""Alignments that positions do not determine: an error after such a fit is no measurement, so it is named undefined."""

import numpy as np
from jaxtyping import Float

STILL_M = 1e-6
"""Positions that spread less never move: files hold them to a micrometre at best."""
STRAIGHT = 1e-3
"""Spread across a path against the spread along it, below which it is a line: no sensor measures positions better."""
NARROW = 0.1
"""Of a path narrower than this the motion across it may be noise; whether both paths share it tells."""
FEWEST = 4
"""Distinct positions: three always lie in a plane, and a fit in space hides most of their error."""
NAMES = ("reference", "trajectory")
COLLAPSED = 0.1
"""Size of the fitted trajectory against the reference's, below which the fit explains under 1 % of it."""


def undefined(reference: Float[np.ndarray, "N 3"], estimate: Float[np.ndarray, "N 3"], alignment: str) -> str | None:
    """Says why an error after the least-squares fit of one path to the other is no measurement; None where it is.

    As `unsolvable`, and where noise decides about the turn around a line. That is told from a narrow path by the
    second singular value of the cross-covariance: the correlation of what both do across the line, tested at 5 sigma.

    Args:
      reference: associated positions, m.
      estimate: associated positions, row by row, m.
      alignment: none, se2, se3 or sim3.
    """
    if (reason := unsolvable(reference, estimate, alignment)) or alignment in ("none", "se2"):
        return reason
    count, centred = len(reference), [_centred(points) for points in (reference, estimate)]
    spreads = [_spreads(points) for points in centred]
    if min(spread[1] / spread[0] for spread in spreads) >= NARROW:
        return None
    shared = np.linalg.svd(centred[0].T @ centred[1], compute_uv=False)[1] / count / (spreads[0][1] * spreads[1][1])
    # Student's t of a correlation, solved for the correlation. Below a half the errors across exceed the motion across.
    if shared < max(0.5, 5 / np.sqrt(count - 2 + 5**2)):
        return "a straight line but for noise, and any turn about it fits as well"
    return None


def unsolvable(reference: Float[np.ndarray, "N 3"], estimate: Float[np.ndarray, "N 3"], alignment: str) -> str | None:
    """Says why many fits of one path to the other are as good, or the best one is a point; None where one is best.

    SE(2) needs two paths that move in x and y: a straight line will do. SE(3) and Sim(3) need paths that are no
    straight line, about which every turn fits as well. Arguments as of `undefined`.
    """
    if alignment == "none":
        return None
    where, size = (" in x and y", 2) if alignment == "se2" else ("", 3)
    centred = [_centred(points[:, :size]) for points in (reference, estimate)]
    for points, name in zip(centred, NAMES, strict=True):
        if np.linalg.norm(points) < STILL_M * np.sqrt(len(points)):
            return f"the {name}'s poses never move{where}"
    if alignment == "se2":
        return None
    distinct = min(len(np.unique(points, axis=0)) for points in (reference, estimate))
    if distinct < FEWEST:
        return f"{distinct} distinct positions; a fit in space needs {FEWEST}"
    for points, name in zip(centred, NAMES, strict=True):
        if (spread := _spreads(points))[1] < STRAIGHT * spread[0]:
            return f"the {name} is a straight line, and any turn about it fits as well"
    return _collapsed(*centred) if alignment == "sim3" else None


def _centred(points: np.ndarray) -> np.ndarray:
    return points - points.mean(axis=0, keepdims=True)


def _spreads(centred: np.ndarray) -> np.ndarray:
    """Standard deviations along the principal axes, largest first."""
    return np.linalg.svd(centred, compute_uv=False) / np.sqrt(len(centred))


def _collapsed(reference: np.ndarray, estimate: np.ndarray) -> str | None:
    left, singular, right = np.linalg.svd(reference.T @ estimate)
    singular[-1] *= np.sign(np.linalg.det(left) * np.linalg.det(right))
    share = singular.sum() / (np.linalg.norm(reference) * np.linalg.norm(estimate))
    if share < COLLAPSED:
        return f"the scale collapses: the best one shrinks the trajectory to {share:.1%} of the reference's size"
    return None
