"""Trajectory errors in NumPy: alignment, absolute (ATE) and relative (RPE) errors, as evo defines them.

Positions and poses are those of the moving frame in the fixed one, metres, one row an instant. An error is meaningless
without its statistic, alignment and association: say all three with every number. Where noise decides about an
alignment is told by `ebjax.evaluation.degenerate.undefined`.
"""

from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from ebjax.evaluation.degenerate import unsolvable

Alignment = Literal["none", "se2", "se3", "sim3"]
ALIGNMENTS: tuple[Alignment, ...] = get_args(Alignment)


def statistics(errors: Float[np.ndarray, " N"]) -> dict[str, float]:
    """Summarises errors: rmse, mean, median, max, min and (population) std, in the errors' unit."""
    return {
        "rmse": float(np.sqrt(np.mean(errors**2))),
        "mean": float(np.mean(errors)),
        "median": float(np.median(errors)),
        "max": float(np.max(errors)),
        "min": float(np.min(errors)),
        "std": float(np.std(errors)),
    }


def _umeyama(source: np.ndarray, target: np.ndarray, *, with_scale: bool) -> np.ndarray:
    """Fits target = s R source + t in D dimensions, least squares (Umeyama 1991, eq. 40-42); returns (D+1, D+1)."""
    size = source.shape[1]
    source_centre, target_centre = source.mean(axis=0), target.mean(axis=0)
    centred = source - source_centre[None]
    variance = np.mean(np.sum(centred**2, axis=1))
    if variance < 1e-20:
        raise ValueError("the poses never move, so no alignment is defined; use alignment none")
    covariance = (target - target_centre[None]).T @ centred / len(source)
    left, singular, right = np.linalg.svd(covariance)
    signs = np.ones(size)
    signs[-1] = np.sign(np.linalg.det(left) * np.linalg.det(right))
    scale = float(singular @ signs) / variance if with_scale else 1.0
    matrix = np.eye(size + 1)
    matrix[:size, :size] = scale * (left * signs[None]) @ right
    matrix[:size, size] = target_centre - matrix[:size, :size] @ source_centre
    return matrix


def align_se2(estimate: Float[np.ndarray, "N 3"], reference: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "4 4"]:
    """Fits reference_from_estimate by a turn about z and a shift in x and y; z stays as it is."""
    planar = _umeyama(estimate[:, :2], reference[:, :2], with_scale=False)
    matrix = np.eye(4)
    matrix[:2, :2], matrix[:2, 3] = planar[:2, :2], planar[:2, 2]
    return matrix


def align_se3(estimate: Float[np.ndarray, "N 3"], reference: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "4 4"]:
    """Fits reference_from_estimate, rigid, by least squares over positions (Umeyama without scale).

    A path in a plane may be turned over onto its mirror image, as evo's `-a` does; `align_se2` never does that.
    """
    return _umeyama(estimate, reference, with_scale=False)


def align_sim3(estimate: Float[np.ndarray, "N 3"], reference: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "4 4"]:
    """Fits reference_from_estimate with a scale, [s R, t], by least squares over positions (Umeyama 1991)."""
    return _umeyama(estimate, reference, with_scale=True)


def align(
    estimate: Float[np.ndarray, "N 3"], reference: Float[np.ndarray, "N 3"], alignment: Alignment
) -> Float[np.ndarray, "4 4"]:
    """Fits reference_from_estimate, `alignment` naming the group; none gives the identity.

    Raises:
      ValueError: the positions do not determine it; says why.
    """
    if alignment == "none":
        return np.eye(4)
    if reason := unsolvable(reference, estimate, alignment):
        raise ValueError(f"alignment {alignment} is undefined: {reason}; use another alignment")
    return {"se2": align_se2, "se3": align_se3, "sim3": align_sim3}[alignment](estimate, reference)


def arc_length(positions: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, " N"]:
    """Returns the path length from the first row to each, metres."""
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    return np.concatenate([np.zeros(1), np.cumsum(steps)])


def arc_length_association(
    reference: Float[np.ndarray, "N 3"], estimate: Float[np.ndarray, "M 3"], samples: int = 1500
) -> tuple[Float[np.ndarray, "S 3"], Float[np.ndarray, "S 3"]]:
    """Resamples both paths at equal shares of their own lengths: where they go, whatever their clocks say.

    Args:
      reference: positions along one path.
      estimate: positions along the other.
      samples: points on each.

    Returns:
      Positions on the reference and on the estimate, row by row at the same share of the way.

    Raises:
      ValueError: a path has no length, or fewer than two samples.
    """
    if samples < 2:
        raise ValueError(f"{samples} samples do not make a path; use two or more")

    def resample(positions: np.ndarray) -> np.ndarray:
        length = arc_length(positions)
        if length[-1] == 0:
            raise ValueError("the poses never move, so the path has no length to be compared along")
        shares = np.linspace(0.0, length[-1], samples)
        return np.stack([np.interp(shares, length, positions[:, k]) for k in range(3)], axis=1)

    return resample(reference), resample(estimate)


def ate(
    reference: Float[np.ndarray, "N 3"],
    estimate: Float[np.ndarray, "N 3"],
    alignment: Alignment = "none",
    first: int | None = None,
) -> dict[str, float]:
    """Absolute trajectory error |p_reference - A p_estimate|, A the least-squares alignment; metres.

    Args:
      reference: associated positions.
      estimate: associated positions, row by row.
      alignment: the group A comes from.
      first: fit A to that many first rows only; None is all.

    Returns:
      `statistics` of the errors.

    Raises:
      ValueError: no rows, or an alignment that the positions do not determine.
    """
    if len(reference) == 0:
        raise ValueError("no associated poses, so there is no error to compute")
    matrix = align(estimate[:first], reference[:first], alignment)
    aligned = estimate @ matrix[:3, :3].T + matrix[None, :3, 3]
    return statistics(np.linalg.norm(reference - aligned, axis=1))


def _invert(poses: np.ndarray) -> np.ndarray:
    inverse = np.tile(np.eye(4), (len(poses), 1, 1))
    inverse[:, :3, :3] = np.swapaxes(poses[:, :3, :3], 1, 2)
    inverse[:, :3, 3] = -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    return inverse


def rpe(
    reference: Float[np.ndarray, "N 4 4"], estimate: Float[np.ndarray, "N 4 4"], delta: int = 1
) -> dict[str, dict[str, float]]:
    """Relative pose error of every pair of rows `delta` apart, E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j) (Sturm 2012, eq. 1).

    Args:
      reference: associated poses Q.
      estimate: associated poses P, row by row.
      delta: rows between i and j.

    Returns:
      `statistics` under "translation_m" (length of E's translation) and "rotation_deg" (angle of E's rotation).

    Raises:
      ValueError: not more than `delta` rows.
    """
    if delta < 1 or len(reference) <= delta:
        raise ValueError(f"{len(reference)} associated poses have no pair {delta} rows apart")
    reference_step = _invert(reference[:-delta]) @ reference[delta:]
    estimate_step = _invert(estimate[:-delta]) @ estimate[delta:]
    error = _invert(reference_step) @ estimate_step
    r = error[:, :3, :3]
    axis = np.stack([r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]], axis=1)
    angle = np.arctan2(np.linalg.norm(axis, axis=1), np.trace(r, axis1=1, axis2=2) - 1)
    return {
        "translation_m": statistics(np.linalg.norm(error[:, :3, 3], axis=1)),
        "rotation_deg": statistics(np.rad2deg(angle)),
    }
