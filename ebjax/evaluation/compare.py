"""A trajectory against a reference: ATE and RPE under every alignment, by time, by row or along the path."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import tyro

from ebjax.evaluation.association import Pairing, pair, pairing_lines
from ebjax.evaluation.clock_hints import better_offset, in_one_unit, ranges, remedy
from ebjax.evaluation.degenerate import undefined
from ebjax.evaluation.trajectory import ALIGNMENTS, arc_length, arc_length_association, ate, rpe
from ebjax.io.trajectory import Trajectory, read

COLUMNS = ("rmse", "mean", "median", "max", "min", "std")
TITLES = {"time": "by time", "row": "by row", "arc": "by arc length"}


@dataclass(frozen=True)
class EvaluationConfig:
    """Measures a trajectory against a reference: ATE and RPE, by time, by row or along the path."""

    trajectory: tyro.conf.Positional[str]
    """The estimate: TUM, EuRoC, KITTI, `x y theta_deg`, g2o or a table with a header, plain or .gz."""
    reference: tyro.conf.Positional[str]
    """What it should have been, in any of the same layouts."""
    match: Literal["auto", "time", "row", "arc"] = "auto"
    """How poses are paired. auto: by time if both files have times, else by row and by arc length."""
    max_time_difference_s: float = 0.01
    """How far apart the times of a pair may be, s."""
    time_offset_s: float = 0.0
    """Added to the trajectory's times before they are paired, s."""
    samples: int = 1500
    """Points at which arc-length association compares the paths."""
    align_first: int = 0
    """Fit the alignment to that many first pairs only; 0 is all."""
    delta: int = 1
    """Frames between the two poses of an RPE pair."""
    out: str | None = None
    """Folder for metrics.json; none is written without it."""


def evaluate(config: EvaluationConfig) -> dict[str, Any]:
    """Reads both files and measures.

    Returns:
      `poses` and `path_m` of the two files; per association `matched` pairs, `ate_m` per alignment, None where the
      positions do not determine it and then why in `undefined`, and, not by arc length, `rpe`; by time
      `time_difference_s` of the pairs; where rows and arc length were both used, `row_lag_m` along the path; `notes`,
      what the user should know, a line each.

    Raises:
      ValueError: an unreadable file, or files that cannot be associated; names file and remedy.
      OSError: a missing file.
    """
    _check(config)
    estimate, reference = read(config.trajectory), read(config.reference)
    for trajectory in (estimate, reference):
        if len(trajectory.poses) < 2:
            raise ValueError(f"{trajectory.path}: one pose only; an error of a trajectory needs two or more")
    metrics: dict[str, Any] = {"trajectory": config.trajectory, "reference": config.reference}
    lengths = [arc_length(_positions(estimate)), arc_length(_positions(reference))]
    metrics |= {"poses": [len(length) for length in lengths], "path_m": [float(length[-1]) for length in lengths]}
    metrics |= {"matched": {}, "ate_m": {}, "undefined": {}, "rpe": {}}
    notes = [*estimate.notes, *reference.notes]
    rows: list[np.ndarray] = []
    for way in _ways(config, estimate, reference):
        if way == "time":
            pairing, remarks = _by_time(config, estimate, reference)
            notes += remarks
            apart = pairing.differences
            metrics["time_offset_s"] = config.time_offset_s
            metrics["time_difference_s"] = {"median": float(np.median(apart)), "max": float(apart.max())}
            rows = [pairing.i, pairing.j]
        elif way == "row":
            _, *rows = np.intersect1d(_row_numbers(reference), _row_numbers(estimate), return_indices=True)
        try:
            if way == "arc":
                points = arc_length_association(_positions(reference), _positions(estimate), config.samples)
            else:
                points = _positions(reference)[rows[0]], _positions(estimate)[rows[1]]
                metrics["rpe"][way] = rpe(reference.poses[rows[0]], estimate.poses[rows[1]], config.delta)
        except ValueError as error:
            if way == "arc" and "row" in metrics["matched"] and config.samples >= 2:
                notes.append(f"not compared by arc length: {error}")
                continue
            raise ValueError(f"{config.trajectory} against {config.reference}: {error}") from None
        metrics["ate_m"][way], metrics["undefined"][way] = {}, {}
        metrics["matched"][way] = len(points[0])
        first = config.align_first or None
        for name in ALIGNMENTS:
            reason = undefined(points[0][:first], points[1][:first], name)
            metrics["ate_m"][way][name] = None if reason else ate(*points, name, first)
            metrics["undefined"][way] |= {name: reason} if reason else {}
    if {"row", "arc"} <= metrics["ate_m"].keys():
        lag = np.abs(lengths[1][rows[0]] - lengths[0][rows[1]])
        worst = int(_row_numbers(reference)[rows[0][lag.argmax()]])
        metrics["row_lag_m"] = {"max": float(lag.max()), "mean": float(lag.mean()), "row": worst}
    return metrics | {"notes": notes}


def _check(config: EvaluationConfig) -> None:
    if config.align_first < 0:
        raise ValueError(f"--align-first is {config.align_first}; give a number of pairs, or 0 for all")
    if not 0 <= config.max_time_difference_s < np.inf:
        raise ValueError(f"--max-time-difference-s is {config.max_time_difference_s:g}; give seconds, 0 or more")
    if not np.isfinite(config.time_offset_s):
        raise ValueError(f"--time-offset-s is {config.time_offset_s:g}; give seconds, 0 for none")


def _positions(trajectory: Trajectory) -> np.ndarray:
    return trajectory.poses[:, :3, 3]


def _row_numbers(trajectory: Trajectory) -> np.ndarray:
    """Of its poses, from 0; rows without a pose count where the file has no times."""
    return np.arange(len(trajectory.poses)) if trajectory.timed else trajectory.timestamps.astype(int)


def _ways(config: EvaluationConfig, estimate: Trajectory, reference: Trajectory) -> list[str]:
    timed, rows = estimate.timed and reference.timed, [int(_row_numbers(one)[-1]) + 1 for one in (estimate, reference)]
    without = config.reference if estimate.timed else config.trajectory
    if config.match == "time" and not timed:
        raise ValueError(f"{without}: it has no times; use --match row or --match arc")
    if config.match == "row" and rows[0] != rows[1]:
        raise ValueError(f"{config.trajectory}: {rows[0]} rows, but {config.reference} has {rows[1]}; use --match arc")
    ways: list[str] = [config.match]
    if config.match == "auto":
        ways = ["time"] if timed else ["row", "arc"] if rows[0] == rows[1] else ["arc"]
    if config.time_offset_s != 0 and ways != ["time"]:
        lack = f"{without} has no times" if not timed else f"--match {config.match} does not look at times"
        raise ValueError(f"--time-offset-s is {config.time_offset_s:g}, but {lack}; leave it out")
    return ways


def _by_time(config: EvaluationConfig, estimate: Trajectory, reference: Trajectory) -> tuple[Pairing, list[str]]:
    offset_s = config.time_offset_s
    reference, estimate, notes = in_one_unit(reference, estimate, offset_s)
    pairing = pair(reference.timestamps, estimate.timestamps + offset_s, config.max_time_difference_s)
    if len(pairing) < 2:
        offset = f" with --time-offset-s {offset_s:g}" if offset_s else ""
        raise ValueError(
            "; ".join(
                [
                    f"{config.trajectory}: {len(pairing)} of {len(estimate.poses)} poses match a time of "
                    f"{config.reference} within {config.max_time_difference_s:g} s{offset}: {ranges(pairing)}",
                    *notes,
                    remedy(reference, estimate, pairing),
                ]
            )
        )
    notes += pairing_lines(pairing)
    if pairing.few:
        notes.append(f"few pairs: {ranges(pairing)}; {remedy(reference, estimate, pairing)}")
    elif hint := better_offset(reference, estimate, pairing, offset_s):
        notes.append(hint)
    return pairing, notes


def report(metrics: dict[str, Any], config: EvaluationConfig) -> str:
    """Formats `evaluate`'s result as a table, and says what was matched or why two associations differ."""
    lines = [f"{'':34}" + "".join(f"{name:>11}" for name in COLUMNS)]
    for way, per_alignment in metrics["ate_m"].items():
        for name, values in per_alignment.items():
            label = f"ATE m, {TITLES[way]}, align {name}"
            lines.append(_row(label, values, metrics["undefined"][way].get(name, "")))
    for way, parts in metrics["rpe"].items():
        for part, unit in (("translation_m", "m"), ("rotation_deg", "deg")):
            lines.append(_row(f"RPE {unit}, {TITLES[way]}, delta {config.delta}", parts[part]))
    lines += metrics["notes"]
    lag = metrics.get("row_lag_m")
    if lag and lag["max"] > 0.01 * metrics["path_m"][1]:
        lines.append(
            f"Why they differ: row by row the two files are up to {lag['max']:.1f} m (row {lag['row']}; mean "
            f"{lag['mean']:.1f} m) out of step along the path; the error by row counts that, the error by arc length "
            "only where the paths go."
        )
    return "\n".join(lines)


def _row(label: str, values: dict[str, float] | None, reason: str = "") -> str:
    numbers = "".join(f"{values[column]:11.6f}" for column in COLUMNS) if values else f"  undefined ({reason})"
    return f"{label:34}{numbers}"
