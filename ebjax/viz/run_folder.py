"""What `ebjax.slam` leaves behind: trajectory, closures, pose graph, metrics, map, figures and the report."""

import csv
import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np

from ebjax.evaluation.run import spread_rows
from ebjax.evaluation.trajectory import align_se2
from ebjax.geometry.camera import raw_from_ideal
from ebjax.geometry.homography import apply
from ebjax.io.sequence import Sequence
from ebjax.io.trajectory import write_tum
from ebjax.posegraph.g2o import format_g2o
from ebjax.slam.believe import THINNED
from ebjax.slam.map import FloorMap, mosaic
from ebjax.slam.recording import Load
from ebjax.slam.run import Run
from ebjax.slam.world import matrices, planar
from ebjax.views.run_view import RunView
from ebjax.views.tilted import tilted
from ebjax.viz import figures
from ebjax.viz.motion import entries, write_steps
from ebjax.viz.report import report
from ebjax.viz.run_page import run_page

COLUMNS = (
    *("i", "j", "name_i", "name_j", "time_i_s", "time_j_s", "direction", "distance", "inliers", "matches"),
    *("x_m", "y_m", "theta_rad", "cov_xx", "cov_xy", "cov_xt", "cov_yy", "cov_yt", "cov_tt"),
    *("measured_by", "kept", "reason"),
)


def write_run(
    folder: Path,
    sequence: Sequence,
    load: Load,
    result: Run,
    metrics: dict[str, Any],
    map_metres_per_px: float,
) -> FloorMap:
    """Writes a run's results into a folder; returns the floor map.

    Args:
      folder: exists.
      sequence: what was run.
      load: frame number -> (RGB, depth), or None.
      result: of the pipeline.
      metrics: what metrics.json is to hold.
      map_metres_per_px: of the floor map.
    """
    candidates, kept, view = result.candidates, result.kept, result.view
    after = result.poses
    poses = matrices(after, like=sequence.odom_from_base)
    if sequence.odom_from_base is not None:
        poses[:, 2, 3] = sequence.odom_from_base[:, 2, 3]
    chosen = np.flatnonzero(kept)
    seen, rows = np.asarray(view.seen), range(len(result.keyframes))
    floor = mosaic(
        map(result.seen, rows), seen, np.asarray(view.floor_from_view, np.float64), after[result.keyframes],
        masks=map(result.floor, rows), metres_per_px=map_metres_per_px,
    )  # fmt: skip
    closures = np.stack([candidates.i[chosen], candidates.j[chosen]], 1)
    pngs = {
        "trajectory": trajectory_figure(sequence, result, closures),
        "floor_map": figures.floor_map(floor.image, floor.extent, after[:, :2], closures),
        "candidates": figures.candidates(
            np.stack([candidates.j, candidates.i], 1), 1 - candidates.distance, kept, len(sequence)
        ),
    }
    best = [match_figure(sequence, load, result, view, int(k)) for k in spread_rows(chosen, 3)]
    doubtful = np.flatnonzero(~kept & (candidates.inliers >= 12) & ~np.isin(result.reasons, [THINNED]))
    rejected = [match_figure(sequence, load, result, view, int(k)) for k in spread_rows(doubtful, 2)]
    table = [closure_row(sequence, result, int(k)) for k in chosen]
    page = run_page(sequence.path.name, metrics, pngs, [f for f in best if f], [f for f in rejected if f], table)
    write_tum(folder / "trajectory.tum", sequence.timestamps, poses, "base_link; starts at odometry's first pose")
    write_closures(folder / "loop_closures.csv", sequence, result)
    if result.motion is not None:
        write_steps(folder / "steps.csv", sequence, result.motion)
    solved = dataclasses.replace(result.graph, poses=result.solution.poses)
    ids = None if result.earlier.count else result.path.frames
    (folder / "pose_graph.g2o").write_text(format_g2o(solved, ids))
    (folder / "metrics.json").write_text(json.dumps(metrics, indent=2) + "\n")
    (folder / "floor_map.png").write_bytes(pngs["floor_map"])
    (folder / "trajectory.png").write_bytes(pngs["trajectory"])
    (folder / "report.html").write_text(report(page), encoding="utf-8")
    return floor


def closure_row(sequence: Sequence, result: Run, k: int) -> list[Any]:
    """A kept closure as the report's table shows it."""
    c = result.candidates
    side = "the opposite side" if c.opposing[k] else "the same side"
    x, y, heading = map(float, c.i_from_j[k])
    counts = [str(c.inliers[k]), str(c.total[k])]
    return [sequence.names[c.i[k]], sequence.names[c.j[k]], side, *counts, x, y, float(np.degrees(heading))]


def trajectory_figure(sequence: Sequence, result: Run, closures: np.ndarray) -> bytes:
    """Before, after and truth; with truth, each path aligned to it as its ATE is."""
    if sequence.odom_from_base is None:
        before = result.path.everywhere(result.path.poses)[:, :2]
    else:
        before = planar(sequence.odom_from_base)[:, :2]
    paths = [before, result.poses[:, :2]]
    if sequence.world_from_base is None:
        return figures.trajectory(paths[0], paths[1], closures=closures)
    truth = planar(sequence.world_from_base)[:, :2]
    known = np.isfinite(truth).all(1)

    def flat(points):
        return np.concatenate([points, np.zeros((len(points), 1))], 1)

    aligned = []
    for path in paths:
        matrix = align_se2(flat(path[known]), flat(truth[known]))
        aligned.append((flat(path) @ matrix[:3, :3].T + matrix[:3, 3])[:, :2])
    return figures.trajectory(aligned[0], aligned[1], truth, closures)


def match_figure(sequence: Sequence, load: Load, result: Run, view: RunView, k: int) -> dict[str, Any] | None:
    """The raw images of a candidate with its matches, the earlier one turned by pi where the view is opposing."""
    candidates = result.candidates
    i, j = int(candidates.i[k]), int(candidates.j[k])
    images = load(i), load(j)
    if images[0] is None or images[1] is None:
        return None
    points = []
    verified = result.verified(k)
    for frame, rows in ((i, verified.query), (j, verified.reference)):
        keypoints = result.keypoints(frame)[rows]
        seen_by = view, result.camera
        if result.lean is not None and result.lean.used:
            seen_by = tilted(*seen_by, result.lean.level_from_base[frame])
        ideal = apply(seen_by[0].image_from_view, np.asarray(keypoints, np.float64))
        points.append(np.asarray(raw_from_ideal(seen_by[1], ideal)))
    used = np.asarray(verified.matched)
    caption = (
        f"{sequence.names[i]} and {sequence.names[j]}: {candidates.inliers[k]} of {candidates.total[k]} matches agree; "
        f"{result.reasons[k]}."
    )
    png = figures.matches(
        images[0][0], images[1][0], points[0][used], points[1][used], np.asarray(verified.inliers)[used],
        turn_second=bool(candidates.opposing[k]),
    )  # fmt: skip
    return {"png": png, "caption": caption}


def write_closures(path: Path, sequence: Sequence, result: Run) -> None:
    """Every verified candidate: where, how alike, what was measured, and whether and why it counts."""
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
