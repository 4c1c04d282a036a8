"""What `ebjax.slam` leaves behind, the report apart: trajectory, closures, pose graph, metrics, map and figures."""

import csv
import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int8

from ebjax.evaluation.trajectory import align_se2
from ebjax.io.sequence import Sequence
from ebjax.io.trajectory import write_tum
from ebjax.posegraph.g2o import format_g2o
from ebjax.slam.map import FloorMap, mosaic
from ebjax.slam.run import Run
from ebjax.slam.world import matrices, planar
from ebjax.viz import figures
from ebjax.viz.motion import entries, write_steps
from ebjax.viz.occupancy import floor_only, occupancy
from ebjax.viz.run_metrics import path_before

COLUMNS = (
    *("i", "j", "name_i", "name_j", "time_i_s", "time_j_s", "direction", "distance", "inliers", "matches"),
    *("x_m", "y_m", "theta_rad", "cov_xx", "cov_xy", "cov_xt", "cov_yy", "cov_yt", "cov_tt"),
    *("measured_by", "kept", "reason"),
)


def write_run(
    folder: Path, sequence: Sequence, result: Run, metrics: dict[str, Any], map_metres_per_px: float
) -> tuple[FloorMap, Int8[np.ndarray, "H W"]]:
    """Writes a run's results into a folder; returns the floor map, and which of its cells are free (`occupancy`).

    Args:
      folder: exists.
      sequence: what was run.
      result: of the pipeline.
      metrics: what metrics.json is to hold.
      map_metres_per_px: of the floor map.
    """
    after = result.poses
    poses = matrices(after, like=sequence.odom_from_base)
    if sequence.odom_from_base is not None:
        poses[:, 2, 3] = sequence.odom_from_base[:, 2, 3]
    floor, cells = floor_of_run(sequence, result, map_metres_per_px)
    closures = np.stack([result.candidates.i, result.candidates.j], 1)[result.kept]
    shown = floor_only(floor, cells)
    write_tum(folder / "trajectory.tum", sequence.timestamps, poses, "base_link; starts at odometry's first pose")
    write_closures(folder / "loop_closures.csv", sequence, result)
    if result.motion is not None:
        write_steps(folder / "steps.csv", sequence, result.motion)
    solved = dataclasses.replace(result.graph, poses=result.solution.poses)
    ids = None if result.earlier.count else result.path.frames
    (folder / "pose_graph.g2o").write_text(format_g2o(solved, ids))
    (folder / "metrics.json").write_text(json.dumps(metrics, indent=2) + "\n")
    (folder / "floor_map.png").write_bytes(figures.floor_map(shown.image, shown.extent, after[:, :2], closures))
    (folder / "trajectory.png").write_bytes(trajectory_figure(sequence, result, closures))
    return floor, cells


def floor_of_run(sequence: Sequence, result: Run, metres_per_px: float) -> tuple[FloorMap, Int8[np.ndarray, "H W"]]:
    """The floor map of a run, and which of its cells are free: without depth, all that a view shows."""
    view, rows = result.view, range(len(result.keyframes))
    seen, floor_from_view = np.asarray(view.seen), np.asarray(view.floor_from_view, np.float64)
    poses = result.poses[result.keyframes]
    views, masks = map(result.seen, rows), map(result.floor, rows)
    floor = mosaic(views, seen, floor_from_view, poses, masks=masks, metres_per_px=metres_per_px)
    clear = map(result.floor, rows) if sequence.has_depth else None
    mount = np.asarray(result.camera.base_from_camera, np.float64)
    return floor, occupancy(clear, seen, floor_from_view, mount, poses, floor)


def trajectory_figure(sequence: Sequence, result: Run, closures: np.ndarray) -> bytes:
    """Before, after and truth; with truth, each path aligned to it as its ATE is."""
    before, after = path_before(sequence, result)[:, :2], result.poses[:, :2]
    closed = bool(len(closures) or result.earlier.closures)
    names: dict[str, Any] = {
        "before_name": "the steps alone" if sequence.odom_from_base is None else "odometry",
        "after_name": "after loop closing" if closed else "trajectory, nothing closed",
    }
    if sequence.world_from_base is None:
        return figures.trajectory(before, after, closures=closures, **names)
    truth = planar(sequence.world_from_base)[:, :2]
    known = np.isfinite(truth).all(1)

    def flat(points):
        return np.concatenate([points, np.zeros((len(points), 1))], 1)

    def aligned(path):
        matrix = align_se2(flat(path[known]), flat(truth[known]))
        return (flat(path) @ matrix[:3, :3].T + matrix[:3, 3])[:, :2]

    return figures.trajectory(aligned(before), aligned(after), truth, closures, **names)


def write_closures(path: Path, sequence: Sequence, result: Run) -> None:
    """Every candidate that was checked: where, how alike, what was measured, and whether and why it counts."""
    c = result.candidates
    with open(path, "w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS)
        for k in range(len(c.i)):
            i, j = int(c.i[k]), int(c.j[k])
            numbers = [*(f"{value:.7f}" for value in c.i_from_j[k]), *entries(c.covariance[k])]
            rows.writerow([
                i, j, sequence.names[i], sequence.names[j], f"{sequence.timestamps[i]:.6f}",
                f"{sequence.timestamps[j]:.6f}", "opposing" if c.opposing[k] else "same", f"{c.distance[k]:.6f}",
                c.inliers[k], c.total[k], *numbers, "depth" if result.by_depth[k] else "floor",
                int(result.kept[k]), result.reasons[k],
            ])  # fmt: skip
