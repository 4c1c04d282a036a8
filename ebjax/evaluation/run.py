"""Figures of merit of a run with ground truth: trajectory error, errors of the closures, reasons. NumPy only."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ebjax.evaluation.degenerate import undefined
from ebjax.evaluation.trajectory import ate


def trajectory_errors(
    truth: Float[np.ndarray, "N 3"], before: Float[np.ndarray, "N 3"], after: Float[np.ndarray, "N 3"]
) -> dict[str, Any]:
    """ATE rmse of odometry and of the corrected path after SE(2) alignment over all frames with truth, m.

    Nothing where fewer than two frames have truth; None, and why, where the robot never moves.

    Args:
      truth: x, y, heading; NaN rows are left out.
      before: odometry.
      after: the corrected path.
    """
    known = np.isfinite(truth).all(1)
    if known.sum() < 2:
        return {}
    flat = [np.concatenate([path[known, :2], np.zeros((int(known.sum()), 1))], 1) for path in (truth, before, after)]
    if reason := undefined(flat[0], flat[1], "se2") or undefined(flat[0], flat[2], "se2"):
        return {"ate_rmse_m": None, "ate_undefined": reason}
    return {
        "ate_rmse_m": {
            "before": ate(flat[0], flat[1], "se2")["rmse"],
            "after": ate(flat[0], flat[2], "se2")["rmse"],
            "alignment": "SE(2)",
            "frames": int(known.sum()),
        }
    }


def closure_errors(
    truth_i: Float[np.ndarray, "K 3"], truth_j: Float[np.ndarray, "K 3"], measured: Float[np.ndarray, "K 3"]
) -> Float[np.ndarray, "K 2"]:
    """Position (m) and heading (rad) of measured against the true i_from_j; NaN where there is no truth."""
    return _apart(_between(truth_i, truth_j), measured)


def closure_errors_between(
    truth_i: Float[np.ndarray, "K 3"],
    truth_j: Float[np.ndarray, "K 3"],
    path_i: Float[np.ndarray, "K 3"],
    path_j: Float[np.ndarray, "K 3"],
) -> Float[np.ndarray, "K 2"]:
    """As `closure_errors`, of what a path has between two of its poses."""
    return _apart(_between(truth_i, truth_j), _between(path_i, path_j))


def _between(a: Float[np.ndarray, "K 3"], b: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "K 3"]:
    d = b - a
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    return np.stack([c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0], d[:, 2]], 1)


def _apart(true: Float[np.ndarray, "K 3"], measured: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "K 2"]:
    error = _between(true, measured)
    heading = np.abs(np.arctan2(np.sin(error[:, 2]), np.cos(error[:, 2])))
    return np.stack([np.hypot(error[:, 0], error[:, 1]), heading], 1)


def closure_summary(errors: Float[np.ndarray, "K 2"], kept: Bool[np.ndarray, " K"]) -> dict[str, Any]:
    """How good the kept closures are: the worst and the median, and how many lie within 5 cm and 1 degree."""
    errors = errors[kept & np.isfinite(errors).all(1)]
    if not len(errors):
        return {}
    right = (errors[:, 0] <= 0.05) & (np.degrees(errors[:, 1]) <= 1.0)
    return {
        "closures_against_truth": {
            "checked": len(errors),
            "within_5cm_1deg": int(right.sum()),
            "position_error_m": {"median": float(np.median(errors[:, 0])), "max": float(errors[:, 0].max())},
            "heading_error_deg": {
                "median": float(np.degrees(np.median(errors[:, 1]))),
                "max": float(np.degrees(errors[:, 1].max())),
            },
        }
    }


def drift(truth: Float[np.ndarray, "N 3"], path: Float[np.ndarray, "N 3"], stretch_m: float = 10.0) -> dict[str, Any]:
    """Drift of a path before any closure: rms error over stretches of path, as a share of it and per metre.

    Args:
      truth: x, y, heading; NaN rows are left out.
      path: the same, estimated.
      stretch_m: length of a stretch by the truth.
    """
    known = np.isfinite(truth).all(1)
    truth, path = truth[known], path[known]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(truth[:, :2], axis=0), axis=1))])
    end = np.searchsorted(along, along + stretch_m)
    start = np.flatnonzero(end < len(along))
    if not len(start):
        return {}
    errors = closure_errors_between(truth[start], truth[end[start]], path[start], path[end[start]])
    return {
        "stretch_m": stretch_m,
        "stretches": len(start),
        "position_share": float(np.sqrt(np.mean(errors[:, 0] ** 2)) / stretch_m),
        "heading_deg_per_m": float(np.degrees(np.sqrt(np.mean(errors[:, 1] ** 2))) / stretch_m),
    }


def reason_counts(reasons: list[str]) -> dict[str, int]:
    """Candidates by reason, most frequent first; numbers that differ within a reason are left out, as "…"."""
    found: dict[str, list[list[str]]] = {}
    for reason in reasons:
        words = reason.split()
        found.setdefault(" ".join("" if _has_digit(word) else word for word in words), []).append(words)
    counts = {" ".join(map(_common, zip(*rows, strict=True))): len(rows) for rows in found.values()}
    return dict(sorted(counts.items(), key=lambda item: -item[1]))


def _common(words: tuple[str, ...]) -> str:
    """A word that all have, or "…" and what follows the number."""
    end = words[0][-1] if words[0][-1] in ",;:" else ""
    return words[0] if len(set(words)) == 1 else f"…{end}"


def _has_digit(word: str) -> bool:
    return any(letter.isdigit() for letter in word)


def spread_rows(rows: Int[np.ndarray, " K"], count: int) -> Int[np.ndarray, " M"]:
    """At most `count` of the rows, evenly spread."""
    if len(rows) <= count:
        return rows
    return rows[np.linspace(0, len(rows) - 1, count).round().astype(int)]
