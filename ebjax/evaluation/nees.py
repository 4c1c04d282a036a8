"""Normalised estimation error squared (NEES) of planar relative poses: is an error as large as its covariance says?

e = log(measured^-1 * true) in the right tangent of SE(2), (x, y, theta) in m and rad; NEES = e^T covariance^-1 e. With
true covariances and Gaussian errors it is chi-squared with 3 degrees of freedom: mean 3, median 2.37. Above 3 the
covariances are too small, below too large. Poses are (x, y, theta) rows. NumPy only.
"""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import gammaincinv

DEGREES_OF_FREEDOM = 3
COLUMNS = ("n", "mean", "median", "95 % of mean", "rms m", "sigma m", "rms deg", "sigma deg")


def between(a: Float[np.ndarray, "K 3"], b: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "K 3"]:
    """a_from_b = a^-1 b of poses in one world, the angle wrapped."""
    d = b - a
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    turn = np.arctan2(np.sin(d[:, 2]), np.cos(d[:, 2]))
    return np.stack([c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0], turn], 1)


def log(pose: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "K 3"]:
    """The tangent (V^-1 t, theta): V^-1 = (theta/2) cot(theta/2) I - (theta/2) [0 -1; 1 0]."""
    theta = np.arctan2(np.sin(pose[:, 2]), np.cos(pose[:, 2]))
    half = theta / 2
    scale = np.cos(half) / np.sinc(half / np.pi)
    x, y = pose[:, 0], pose[:, 1]
    return np.stack([scale * x + half * y, scale * y - half * x, theta], 1)


def tangent_errors(measured: Float[np.ndarray, "K 3"], true: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "K 3"]:
    """log(measured^-1 * true); NaN where there is no truth."""
    return log(between(measured, true))


def nees(error: Float[np.ndarray, "K 3"], covariance: Float[np.ndarray, "K 3 3"]) -> Float[np.ndarray, " K"]:
    """e^T covariance^-1 e of every row; the covariances must be positive definite."""
    return np.sum(error * np.linalg.solve(covariance, error[:, :, None])[:, :, 0], 1)


def with_scale(
    covariance: Float[np.ndarray, "K 3 3"], a_from_b: Float[np.ndarray, "K 3"], sigma: float
) -> Float[np.ndarray, "K 3 3"]:
    """Covariances of relative poses, right tangent, where a scale that all share has the standard deviation `sigma`."""
    c, s, (x, y, _) = np.cos(a_from_b[:, 2]), np.sin(a_from_b[:, 2]), a_from_b.T
    stretch = sigma * np.stack([c * x + s * y, c * y - s * x, np.zeros(len(a_from_b))], 1)
    return covariance + stretch[:, :, None] * stretch[:, None, :]


def mean_interval(n: int, share: float = 0.95) -> tuple[float, float]:
    """Where the mean of n independent NEES lies with probability `share`: quantiles of chi-squared(3 n) / n."""
    low, high = (2 * gammaincinv(DEGREES_OF_FREEDOM * n / 2, p) / n for p in ((1 - share) / 2, (1 + share) / 2))
    return float(low), float(high)


def summary(error: Float[np.ndarray, "K 3"], covariance: Float[np.ndarray, "K 3 3"]) -> dict[str, Any]:
    """Count, mean and median of NEES, the interval expected of the mean; rms of errors and of the sigmas claimed.

    The rms in m is over the length of (x, y), of the sigmas over sqrt(cov_xx + cov_yy). There must be a row.
    """
    values = nees(error, covariance)
    variance = np.diagonal(covariance, axis1=1, axis2=2).mean(0)
    square = np.mean(error**2, 0)
    return {
        "n": len(values),
        "nees_mean": float(values.mean()),
        "nees_median": float(np.median(values)),
        "nees_mean_interval": list(mean_interval(len(values))),
        "rms_error_m": float(np.sqrt(square[0] + square[1])),
        "rms_sigma_m": float(np.sqrt(variance[0] + variance[1])),
        "rms_error_deg": float(np.degrees(np.sqrt(square[2]))),
        "rms_sigma_deg": float(np.degrees(np.sqrt(variance[2]))),
    }


def summaries(
    error: Float[np.ndarray, "K 3"], covariance: Float[np.ndarray, "K 3 3"], groups: dict[str, list[str]] | None = None
) -> dict[str, Any]:
    """`summary` of the rows with truth under "all", and of those that share a label in one of the groups.

    Args:
      error: NaN rows are left out.
      covariance: of the errors.
      groups: a label for every row by the group's name; {"gap": ["1", "4", ...]} gives "gap 1" and "gap 4".
    """
    known = np.isfinite(error).all(1)
    if not known.any():
        return {}
    result = {"all": summary(error[known], covariance[known])}
    for name, labels in (groups or {}).items():
        of_row = np.array(labels)
        for label in sorted(set(of_row[known].tolist()), key=lambda text: (int(text) if text.isdecimal() else 0, text)):
            rows = known & (of_row == label)
            result[f"{name} {label}"] = summary(error[rows], covariance[rows])
    return result


def pairs_along(
    path_m: Float[np.ndarray, " N"], known: Bool[np.ndarray, " N"], distance_m: float, count: int
) -> tuple[Int[np.ndarray, " K"], Int[np.ndarray, " K"]]:
    """At most `count` pairs of frames `distance_m` apart along the path, their starts evenly spread over it.

    Pairs overlap where the path is short. A pair counts if the path between its frames is within a fifth of the
    distance.

    Args:
      path_m: path length from the first frame to each.
      known: frames that may be taken.
      distance_m: along the path.
      count: pairs at most.
    """
    rows = np.flatnonzero(known)
    at = path_m[rows]
    if len(rows) < 2 or at[-1] - at[0] < 0.8 * distance_m:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    a = np.searchsorted(at, np.linspace(at[0], max(at[-1] - distance_m, at[0]), count) - 1e-9)
    after = np.clip(np.searchsorted(at, at[a] + distance_m), 1, len(at) - 1)
    b = after - (at[a] + distance_m - at[after - 1] <= at[after] - at[a] - distance_m)
    near = (b > a) & (np.abs(at[b] - at[a] - distance_m) <= 0.2 * distance_m)
    pairs = np.unique(np.stack([a, b], 1)[near], axis=0)
    return rows[pairs[:, 0]], rows[pairs[:, 1]]


def table(results: dict[str, dict[str, Any]]) -> list[str]:
    """The summaries as lines: {"steps": {"all": ..., "gap 1": ...}} gives the rows "steps" and "steps, gap 1"."""
    named = {
        section if name == "all" else f"{section}, {name}": values
        for section, rows in results.items()
        for name, values in rows.items()
    }
    width = max(20, *map(len, named)) if named else 20
    lines = [f"{'NEES, expected mean 3':{width + 2}}" + "{:>6}{:>9}{:>9}{:>16}{:>9}{:>9}{:>9}{:>11}".format(*COLUMNS)]
    for name, v in named.items():
        interval = "{:.2f} to {:.2f}".format(*v["nees_mean_interval"])
        sizes = f"{v['rms_error_m']:9.4f}{v['rms_sigma_m']:9.4f}{v['rms_error_deg']:9.3f}{v['rms_sigma_deg']:11.3f}"
        means = f"{v['n']:6}{v['nees_mean']:9.2f}{v['nees_median']:9.2f}{interval:>16}"
        lines.append(f"{name:{width + 2}}{means}{sizes}")
    return lines
