"""Reads the measurements that a run left in steps.csv and loop_closures.csv, with their covariances.

A row says: frame j seen from frame i is (x_m, y_m, theta_rad), i_from_j, and the covariance of log(measured^-1 * true)
in the right tangent is cov_xx to cov_tt, m and rad. Frames are rows of the run's trajectory.tum.
"""

import csv
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

POSE = ("x_m", "y_m", "theta_rad")
COVARIANCE = ("cov_xx", "cov_xy", "cov_xt", "cov_yy", "cov_yt", "cov_tt")
REQUIRED = ("i", "j", "time_i_s", "time_j_s", *POSE, *COVARIANCE)
SAME_TIME_S = 1e-3


@dataclass(frozen=True)
class Measurements:
    """The rows of a table that count.

    Attributes:
      i: frame a measurement is taken in.
      j: frame it measures.
      i_from_j: x, y (m), theta (rad).
      covariance: of log(measured^-1 * true), positive definite.
      labels: further columns by name, as text.
      rows: rows of the table, those that do not count among them.
    """

    i: Int[np.ndarray, " K"]
    j: Int[np.ndarray, " K"]
    i_from_j: Float[np.ndarray, "K 3"]
    covariance: Float[np.ndarray, "K 3 3"]
    labels: dict[str, list[str]]
    rows: int


def read_measurements(
    path: str | Path, flag: str, times: Float[np.ndarray, " N"], labels: Iterable[str] = ()
) -> Measurements:
    """Reads the rows whose column `flag` is 1; an empty file, or one of a header alone, has none.

    Args:
      path: the file.
      flag: "used" or "kept"; 1 or 0.
      times: of the frames, s; a row's own times must be those of its frames.
      labels: further columns to hand on.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: a missing column, a wrong number of fields, a number that is none, a frame that the run does not have,
        times of another run, a covariance that is not positive definite; names file, line and remedy.
    """
    labels = tuple(labels)
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            missing = [name for name in (*REQUIRED, flag, *labels) if name not in (reader.fieldnames or ())]
            if missing and reader.fieldnames:
                raise ValueError(f"{path}: no column {', '.join(missing)}; write the run again: python -m ebjax.slam")
            rows = [(f"{path} line {reader.line_num}", row) for row in reader]
    except (UnicodeDecodeError, csv.Error):
        raise ValueError(f"{path}: not a table of text; write the run again: python -m ebjax.slam") from None
    for where, row in rows:
        if None in row or None in row.values():
            raise ValueError(f"{where}: not {len(reader.fieldnames or ())} fields as in the header; correct the line")
        if row[flag] not in ("0", "1"):
            raise ValueError(f"{where}: {flag} is {row[flag]!r}; it must be 1 or 0")
    counting = [(where, row) for where, row in rows if row[flag] == "1"]
    frames = np.array([_frames(where, row, times) for where, row in counting], np.int64).reshape(-1, 2)
    poses = np.array([_numbers(where, row, POSE) for where, row in counting], float).reshape(-1, 3)
    upper = np.array([_numbers(where, row, COVARIANCE) for where, row in counting], float).reshape(-1, 6)
    covariance = upper[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    wrong = np.flatnonzero(np.linalg.eigvalsh(covariance)[:, 0] <= 0)
    if len(wrong):
        raise ValueError(f"{counting[wrong[0]][0]}: the covariance is not positive definite; correct the line")
    texts = {name: [row[name] for _, row in counting] for name in labels}
    return Measurements(frames[:, 0], frames[:, 1], poses, covariance, texts, len(rows))


def _numbers(where: str, row: dict[str, str], names: Iterable[str]) -> list[float]:
    values = []
    for name in names:
        try:
            values.append(float(row[name]))
        except ValueError:
            values.append(math.nan)
        if not math.isfinite(values[-1]):
            raise ValueError(f"{where}: {name} is {row[name][:80]!r}; it must be a finite number")
    return values


def _frames(where: str, row: dict[str, str], times: np.ndarray) -> list[int]:
    frames = []
    for name, own in zip("ij", _numbers(where, row, ("time_i_s", "time_j_s")), strict=True):
        if not row[name].isdecimal() or int(row[name]) >= len(times):
            raise ValueError(
                f"{where}: {name} is {row[name][:80]!r}, and trajectory.tum has frames 0 to {len(times) - 1}; "
                "take both files from one run"
            )
        frames.append(int(row[name]))
        if abs(times[frames[-1]] - own) > SAME_TIME_S:
            raise ValueError(
                f"{where}: time_{name}_s is {own:.6f}, but frame {row[name]} of trajectory.tum is at "
                f"{times[frames[-1]]:.6f} s; take both files from one run"
            )
    if frames[0] == frames[1]:
        raise ValueError(f"{where}: i and j are both {frames[0]}; correct or remove the line")
    return frames
