"""`python -m ebjax.paper keypoints`: are matched keypoints of the floor placed as well as their covariances say?

A run measures steps and closures from matches, each with a covariance (`ebjax.features.settle`): a patch's, times a
factor, the scale of Student's t with nu = 3, that the pair's residuals tell by their median. Under the true motion a
match is off by r, and q = r^T (factor patch)^-1 r. NEES is the mean of q (nu - 2) / nu, r against Student's covariance:
2, the number of degrees of freedom, is right. Mismatches within the tolerance count in full.
"""

import dataclasses
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ebjax.command import progress
from ebjax.features.settle import FREEDOM, PairMatches, spread_on_floor, white
from ebjax.front.close import close_loops
from ebjax.front.log import Log, open_log
from ebjax.front.run import Run
from ebjax.geometry.camera import Camera
from ebjax.geometry.planar import between
from ebjax.io.atomic import whole_file
from ebjax.paper import page
from ebjax.slam.config import PipelineConfig

STEPS, CLOSURES = "steps", "closures"
DEGREES_OF_FREEDOM, INSIDE = 2, 0.95
LIMIT = FREEDOM * ((1 - INSIDE) ** (-2 / FREEDOM) - 1)
"""Of q: below it lies a share INSIDE of Student's t in two dimensions."""
MEDIAN = FREEDOM * (0.5 ** (-2 / FREEDOM) - 1)
"""Of q."""


@dataclasses.dataclass(frozen=True)
class Placed:
    """How well the matches of one pair are placed.

    Attributes:
      matches: how many count.
      nees: their mean.
      inside: the share of them in the region where INSIDE is expected.
      error_m: the median of their errors, m.
    """

    matches: int
    nees: float
    inside: float
    error_m: float


def placed(
    matches: PairMatches,
    camera: Camera,
    measured: Float[np.ndarray, "3"],
    true: Float[np.ndarray, "3"],
    tolerance_m: float,
) -> Placed | None:
    """One pair's matches under the true motion; None where none of them counts.

    Args:
      matches: of the pair.
      camera: as it is mounted.
      measured: i_from_j that they settled on, which says the factor.
      true: i_from_j.
      tolerance_m: matches that are farther off count for nothing.
    """
    points_i, points_j, spread = spread_on_floor(matches, camera)

    def off(motion):
        c, s = np.cos(motion[2]), np.sin(motion[2])
        plain = np.asarray(points_i) - (np.asarray(points_j) @ np.array([[c, s], [-s, c]]) + motion[:2])
        error = np.linalg.norm(plain, axis=1)
        squared = np.sum(np.asarray(white(jnp.asarray(plain), spread)) ** 2, 1)
        return error, squared, np.asarray(matches.matched) & (error < tolerance_m)

    _, residuals, agreeing = off(measured)
    error, squared, near = off(true)
    if not (near.any() and agreeing.any()):
        return None
    q = squared[near] * MEDIAN / np.median(residuals[agreeing])
    nees = np.mean(q) * (FREEDOM - 2) / FREEDOM
    return Placed(int(near.sum()), float(nees), float(np.mean(q < LIMIT)), float(np.median(error[near])))


def pairs_of(run: Run, truth: Float[np.ndarray, "F 3"]) -> Iterator[tuple[str, Placed]]:
    """Every used step of the floor and every kept closure of a run, and how well its matches are placed."""
    poses, row_of = truth[run.keyframes], {int(frame): row for row, frame in enumerate(run.keyframes)}
    ends: list[tuple[str, int, int, bool, np.ndarray]] = []
    if run.motion is not None:
        steps = run.motion.steps.rows(run.motion.steps.used & (run.motion.steps.kind == "floor"))
        ends += [(STEPS, i, j, False, m) for i, j, m in zip(steps.i, steps.j, steps.i_from_j, strict=True)]
    kept = run.closures
    for i, j, opposing, motion in zip(kept.i, kept.j, kept.opposing, kept.i_from_j, strict=True):
        ends.append((CLOSURES, row_of[int(i)], row_of[int(j)], bool(opposing), motion))
    for kind, i, j, opposing, measured in progress(ends, len(ends), "pairs"):
        true = between(poses[i][None], poses[j][None])[0]
        if not np.isfinite(true).all():
            continue
        matches = jax.tree.map(np.asarray, run.looked.pair(int(i), int(j), opposing).matches)
        found = placed(matches, run.camera, measured, true, PipelineConfig.tolerance_m)
        if found is not None:
            yield kind, found


def make(logs: Sequence[Path], out: Path) -> list[str]:
    """Drives the logs, measures, writes keypoints.json and keypoints.md; see `ebjax.paper.__main__.KeypointsConfig`.

    Returns:
      the lines of the table.

    Raises:
      ValueError: two logs of one name, one without truth; names it.
    """
    if len({path.resolve().name for path in logs}) < len(logs):
        raise ValueError(f"two of {', '.join(map(str, logs))} have the same name, by which the table tells them apart")
    opened = {path.resolve().name: open_log(path, depth="none") for path in logs}
    truths = {name: _truth(log) for name, log in opened.items()}
    found: dict[str, Any] = {}
    for name, log in opened.items():
        told = list(pairs_of(close_loops(log, quiet=True), truths[name]))
        found[name] = {kind: _mean([one for which, one in told if which == kind]) for kind in (STEPS, CLOSURES)}
    lines, right = table(found), {"nees": DEGREES_OF_FREEDOM, "inside": INSIDE}
    with whole_file(out / "keypoints.json") as file:
        json.dump({"right": right, "runs": found}, file, indent=1, allow_nan=False)
    with whole_file(out / "keypoints.md") as file:
        file.write("\n".join(["# Matched keypoints", "", *lines]))
    return lines


def _truth(log: Log) -> Float[np.ndarray, "F 3"]:
    truth = log.truth
    if truth is None or not np.isfinite(truth).all(1).any():
        raise ValueError(f"{log.sequence.path}: keypoints needs the truth of a run, and the log has none")
    return truth


def _mean(some: list[Placed]) -> dict[str, Any] | None:
    """Over the pairs; None without any."""
    if not some:
        return None
    mean = {name: float(np.mean([getattr(one, name) for one in some])) for name in ("nees", "inside", "error_m")}
    return {"pairs": len(some), "matches": sum(one.matches for one in some), **mean}


def table(found: Mapping[str, Mapping[str, Mapping[str, Any] | None]]) -> list[str]:
    """A row for the steps and one for the closures of every run."""
    rows = {}
    for name, kinds in found.items():
        for kind, mean in kinds.items():
            rows[f"{name}, {kind}"] = ["0", *[page.DASH] * 4] if mean is None else _cells(mean)
    head = ["", "pairs", "matches", "NEES", "inside, %", "median error, mm"]
    right = f"Right: a NEES of {DEGREES_OF_FREEDOM}, and {100 * INSIDE:.0f} % inside."
    return [*page.markdown_table(head, rows), right, ""]


def _cells(mean: Mapping[str, Any]) -> list[str]:
    numbers = f"{mean['nees']:.2f}", page.percent(mean["inside"]), f"{1000 * mean['error_m']:.2f}"
    return [str(mean["pairs"]), str(mean["matches"]), *numbers]
