"""Table 4: what closing loops does to the trajectory, against odometry, on runs with truth and on the real graph of D5.

Rows: odometry; loop closures off (the same pose graph without closures: what it must come to is odometry); closures of
the same direction only, which is what a robot has that cannot recognise a place from the other side; ours.
"""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ebjax.evaluation.run import closure_errors, closure_summary, reason_counts
from ebjax.evaluation.trajectory import align_se2, arc_length_association, ate
from ebjax.io.sequence import require_odometry
from ebjax.io.trajectory import read
from ebjax.paper.run import Run
from ebjax.posegraph import init
from ebjax.posegraph.g2o import read_g2o
from ebjax.posegraph.lm import solve
from ebjax.slam.config import PipelineConfig
from ebjax.slam.measured import Measured
from ebjax.slam.pipeline import run as run_pipeline
from ebjax.slam.recording import Recording
from ebjax.slam.run import Run as Result
from ebjax.slam.world import planar

ODOMETRY, OFF, SAME, OURS = "odometry", "loop closures off", "same direction only", "ours"
ROWS = (ODOMETRY, OFF, SAME, OURS)
FALSE_M, FALSE_DEG = 0.3, 5.0
"""A kept closure farther off the truth than either is false."""
REAL_D5 = "D5 (real graph)"
ALIGN_FIRST = 70
"""Poses of D5 that the authors align by."""


@dataclasses.dataclass(frozen=True)
class Closed:
    """A run through the pipeline.

    Attributes:
      run: what went in.
      odometry: x, y, heading of every frame.
      result: what came out.
      errors: of every candidate, position (m) and heading (rad) against the truth.
    """

    run: Run
    odometry: Float[np.ndarray, "N 3"]
    result: Result
    errors: Float[np.ndarray, "K 2"]

    @property
    def false(self) -> Bool[np.ndarray, " K"]:
        """Kept closures that are false."""
        far = (self.errors[:, 0] > FALSE_M) | (np.degrees(self.errors[:, 1]) > FALSE_DEG)
        return self.result.kept & far

    def path(self, kept: Bool[np.ndarray, " K"], config: PipelineConfig) -> Float[np.ndarray, "N 3"]:
        """The trajectory with some of the candidates as closures."""
        graph = self.result.path.graph(self.result.candidates, kept)
        poses = solve(graph, kernel=config.kernel, width=config.kernel_width, max_steps=100).poses
        return self.result.path.everywhere(np.asarray(poses))


def close_loops(run: Run, config: PipelineConfig) -> Closed:
    """Runs the pipeline on all frames of a run."""

    def load(k: int) -> tuple[np.ndarray, np.ndarray | None]:
        return run.sequence.rgb(k), run.sequence.depth(k) if run.sequence.has_depth else None

    odometry = planar(require_odometry(run.sequence))
    result = run_pipeline(Recording(load, run.sequence.timestamps, odometry), run.camera, run.view, config)
    c: Measured = result.candidates
    return Closed(run, odometry, result, closure_errors(run.truth[c.i], run.truth[c.j], c.i_from_j))


def ate_rmse_m(truth: Float[np.ndarray, "N 3"], path: Float[np.ndarray, "N 3"]) -> float:
    """ATE rmse of positions after SE(2) alignment over all frames, m."""
    return ate(_flat(truth), _flat(path), "se2")["rmse"]


def aligned(truth: Float[np.ndarray, "N 3"], path: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 2"]:
    """x, y of a path, aligned as its ATE is."""
    matrix = align_se2(_flat(path), _flat(truth))
    return (_flat(path) @ matrix[:3, :3].T + matrix[None, :3, 3])[:, :2]


def _flat(path: np.ndarray) -> np.ndarray:
    return np.concatenate([path[:, :2], np.zeros((len(path), 1))], 1)


def measure(closed: Closed, config: PipelineConfig) -> dict[str, dict[str, Any]]:
    """The four rows on one run: `ate_rmse_m`, its share of odometry's, the closures used and how many are false."""
    result, truth = closed.result, closed.run.truth
    kept, none = result.kept, np.zeros(len(result.kept), bool)
    used = {ODOMETRY: none, OFF: none, SAME: kept & ~result.candidates.opposing, OURS: kept}
    rows: dict[str, dict[str, Any]] = {}
    before = ate_rmse_m(truth, closed.odometry)
    for name, chosen in used.items():
        path = closed.odometry if name == ODOMETRY else closed.path(chosen, config)
        error = ate_rmse_m(truth, path)
        rows[name] = {
            "ate_rmse_m": error,
            "share_of_odometry": error / before,
            "closures": int(chosen.sum()),
            "false_closures": int((chosen & closed.false).sum()),
        }
    rows[OURS] |= closure_summary(closed.errors, kept) | {
        "candidates": len(kept),
        "reasons": reason_counts(result.reasons),
        "frames": len(truth),
        "travelled_m": round(closed.run.travelled_m, 2),
    }
    return rows


def measure_d5(folder: Path, config: PipelineConfig) -> dict[str, dict[str, Any]]:
    """The authors' own graph of D5, odometry and the six loops they measured, optimised by us; it has no images.

    `ate_mean_m` is as in the paper: row by row, aligned by the first 70 poses. The truth's rows are out of step with
    the run's; `ate_rmse_m` compares along the path, 1500 points, SE(2)-aligned.

    Raises:
      OSError, ValueError: a file is missing or unreadable.
    """
    graph, _ = read_g2o(folder / "lessNoise.g2o")
    truth = read(folder / "denseGt2.kitti").poses[:, :3, 3]
    loops = np.abs(np.asarray(graph.i) - np.asarray(graph.j)) != 1
    graph = dataclasses.replace(graph, robust=loops, poses=init.odometry(graph))
    chain = np.flatnonzero(~loops)
    alone = dataclasses.replace(
        graph, **{name: getattr(graph, name)[chain] for name in ("i", "j", "measured", "information", "robust")}
    )
    start = np.asarray(graph.poses)
    paths = {ODOMETRY: start}
    for name, chosen in ((OFF, alone), (OURS, graph)):
        paths[name] = np.asarray(solve(chosen, kernel=config.kernel, width=config.kernel_width).poses)
    paths |= {f"published {name}": _published(folder / f"{file}.kitti") for name, file in PUBLISHED_PATHS.items()}
    rows: dict[str, dict[str, Any]] = {}
    for name, path in paths.items():
        errors = ate(*arc_length_association(truth, _flat(path)), "se2")
        rows[name] = {
            "ate_rmse_m": errors["rmse"],
            "ate_mean_m": ate(truth, _flat(path), "se2", ALIGN_FIRST)["mean"],
            "closures": int(loops.sum()) if name == OURS else 0 if name in ROWS else None,
        }
    for row in rows.values():
        row["share_of_odometry"] = row["ate_rmse_m"] / rows[ODOMETRY]["ate_rmse_m"]
    return rows


PUBLISHED_PATHS = {"RTAB-Map": "rtabmap", "Early Bird": "vpr5"}


def _published(path: Path) -> np.ndarray:
    return read(path).poses[:, :2, 3]
