"""`python -m ebjax.slam [SEQUENCE] --out RUN`: closes loops from opposing viewpoints on a run and corrects its trajectory."""

import csv
import dataclasses
import json
import resource
import sys
import time
from pathlib import Path
from typing import Annotated, Any, Literal

import jax.numpy as jnp
import numpy as np
import tyro

from ebjax.command import dump_config, progress, run
from ebjax.evaluation.run import closure_errors, closure_summary, reason_counts, spread_rows, trajectory_errors
from ebjax.floors.__main__ import render_sequence
from ebjax.floors.sequence import CorridorConfig
from ebjax.geometry.camera import Camera, FloorView
from ebjax.io.atomic import whole_file, whole_folder
from ebjax.io.sequence import BrokenFrame, Sequence, read_sequence
from ebjax.io.trajectory import write_tum
from ebjax.places.recall import facing_pairs, precision_100, recall_at_1
from ebjax.posegraph.g2o import format_g2o
from ebjax.slam.floor import camera_from_depth, floor_error_m
from ebjax.slam.map import mosaic
from ebjax.slam.pipeline import PipelineConfig, Result
from ebjax.slam.pipeline import run as run_pipeline
from ebjax.slam.view import choose_floor, from_camera, from_quad
from ebjax.slam.world import matrices, planar
from ebjax.viz import figures
from ebjax.viz.report import report
from ebjax.viz.run_page import run_page

Quad = tuple[float, float, float, float, float, float, float, float]
PAPER_RADIUS = 1 / 15


@dataclasses.dataclass(frozen=True)
class Config(PipelineConfig):
    """Finds where the robot drove the other way over the same floor, and corrects its odometry with it."""

    sequence: tyro.conf.Positional[Path | None] = None
    """Folder in TUM layout (rgb.txt, camera.json, odometry.txt; depth.txt, groundtruth.txt). None: a synthetic corridor."""
    out: Path = Path("runs/slam")
    """Folder for the results."""
    depth: Literal["sequence", "none"] = "sequence"
    """Measure loops by the sequence's depth where it has any, or by the metric floor alone."""
    floor: Literal["camera", "depth"] = "camera"
    """Where the floor lies: as camera.json's T_base_camera says, or as a plane fitted to the depth images."""
    quad: Quad | None = None
    """Four image points of a rectangle on the floor, px: far left, far right, near right, near left (x y each)."""
    quad_margin: float = 0.5
    """How far the floor view reaches beyond the quad, as a share of its sides."""
    view: tuple[float, float, float, float] | None = None
    """Rectangle of floor that is looked at, m in base: x_min x_max y_min y_max. None: chosen from the camera."""
    metres_per_px: float = 0.01
    """Of the floor view, m."""
    map_metres_per_px: float = 0.02
    """Of the floor map, m."""
    max_time_difference_s: float = 0.02
    """How far apart in time an image may be from its depth image or pose, s."""
    min_coverage: float = 0.9
    """Share of frames that must have odometry (and depth)."""
    min_readable: float = 0.5
    """Share of frames that must be readable; fewer end the run."""


class Frames:
    """The run's images, decoded when asked for; frames that cannot be read are noted and left out."""

    def __init__(self, sequence: Sequence):
        self.sequence = sequence
        self.broken: dict[str, str] = {}

    def load(self, k: int):
        """RGB and depth of frame k, or None."""
        try:
            return self.sequence.rgb(k), self.sequence.depth(k) if self.sequence.has_depth else None
        except BrokenFrame as fault:
            self.broken[self.sequence.names[k]] = " ".join(str(fault).split())
            return None


def main(config: Config) -> None:
    """Reads, runs, writes."""
    started = time.perf_counter()
    if config.sequence is None:
        config = dataclasses.replace(config, sequence=config.out / "sequence")
        if not (config.out / "sequence" / "rgb.txt").is_file():
            print(f"no sequence given: rendering a synthetic corridor into {config.sequence}")
            render_sequence(CorridorConfig(), config.out / "sequence")
    assert config.sequence is not None
    sequence = read_sequence(
        config.sequence,
        depth=config.depth == "sequence",
        max_time_difference_s=config.max_time_difference_s,
        min_coverage=config.min_coverage,
    )
    frames = Frames(sequence)
    camera = run_camera(config, sequence, frames)
    try:
        if config.quad is not None:
            view = from_quad(camera, np.array(config.quad, np.float64).reshape(4, 2), config.quad_margin)
        elif config.view is not None:
            view = from_camera(camera, FloorView(*config.view, config.metres_per_px))
        else:
            view = from_camera(camera, choose_floor(camera, config.metres_per_px))
    except ValueError as fault:
        raise ValueError(f"{sequence.path / 'camera.json'}: {fault}") from None

    odometry = planar(sequence.odom_from_base)
    result = run_pipeline(frames.load, sequence.timestamps, odometry, camera, view, config, progress)
    check_images(config, sequence, frames, result)
    metrics = run_metrics(sequence, frames, result, view.centre_m)
    metrics["seconds"] = {name: round(value, 3) for name, value in result.seconds.items()}
    metrics["ms_per_frame"] = round(1e3 * sum(result.seconds.values()) / len(sequence), 2)
    write_outputs(config, sequence, frames, result, view, metrics, started)
    print_summary(config, metrics)


def run_camera(config: Config, sequence: Sequence, frames: Frames) -> Camera:
    """The camera as camera.json says, or over the floor that the depth images show."""
    file = sequence.camera
    camera = Camera(jnp.asarray(file.intrinsics), jnp.asarray(file.base_from_camera), file.width, file.height)
    if config.floor == "camera":
        return camera
    if not sequence.has_depth:
        raise ValueError(f"{sequence.path}: --floor depth needs depth.txt and --depth sequence")
    chosen = spread_rows(np.arange(len(sequence)), 9)
    depths = [images[1] for images in map(frames.load, chosen) if images is not None and images[1] is not None]
    try:
        camera, height_m, pitch_deg, roll_deg = camera_from_depth(depths, camera)
    except ValueError as fault:
        raise ValueError(f"{sequence.path / 'depth.txt'}: {fault}") from None
    print(f"floor from depth: camera {height_m:.3f} m above it, pitch {pitch_deg:.2f} deg, roll {roll_deg:.2f} deg")
    return camera


def check_images(config: Config, sequence: Sequence, frames: Frames, result: Result) -> None:
    """Refuses a run of which too little could be read; warns where depth and camera.json disagree about the floor."""
    asked = len(result.keyframes) + len(frames.broken)
    if len(result.keyframes) < config.min_readable * asked:
        raise ValueError(
            f"{sequence.path / 'rgb.txt'}: {len(frames.broken)} of {asked} frames could not be read, "
            f"first {next(iter(frames.broken.values()))}; repair them, or set --min-readable lower"
        )
    if not sequence.has_depth:
        return
    if not (result.described.range_m > 0).any():
        raise ValueError(
            f"{sequence.path / 'depth.txt'}: no depth on the floor in any of {len(result.keyframes)} frames "
            "(all zero or not finite); check depth_scale in camera.json, or run with --depth none"
        )
    error = floor_error_m(result.described)
    if error > 0.05:
        print(
            f"warning: depth sees the floor {error:.2f} m (median) off where T_base_camera puts it; "
            "correct camera.json, or try --floor depth",
            file=sys.stderr,
        )


def run_metrics(sequence: Sequence, frames: Frames, result: Result, centre_m: np.ndarray) -> dict[str, Any]:
    """What metrics.json says, times apart."""
    candidates, kept = result.candidates, result.kept
    after = np.asarray(result.solution.poses)
    travelled = float(np.linalg.norm(np.diff(planar(sequence.odom_from_base)[:, :2], axis=0), axis=1).sum())
    metrics: dict[str, Any] = {
        "sequence": str(sequence.path),
        "frames": len(sequence),
        "keyframes": len(result.keyframes),
        "travelled_m": round(travelled, 3),
        "broken_frames": dict(frames.broken),
        "frames_without_odometry": dict(sequence.dropped),
        "candidates": len(candidates.i),
        "closures_kept": int(kept.sum()),
        "closures_opposing": int((kept & candidates.opposing).sum()),
        "closures_by_depth": int((kept & result.by_depth).sum()),
        "reasons": reason_counts(result.reasons),
        "pose_graph": {
            "cost_before": float(result.solution.initial_cost),
            "cost_after": float(result.solution.cost),
            "iterations": int(result.solution.iterations),
            "converged": int(result.solution.status) == 0,
        },
    }
    if sequence.world_from_base is None:
        return metrics
    truth = planar(sequence.world_from_base)
    metrics |= trajectory_errors(truth, planar(sequence.odom_from_base), after)
    errors = closure_errors(truth[candidates.i], truth[candidates.j], candidates.i_from_j)
    metrics |= closure_summary(errors, kept)
    ranked = result.ranked
    first = np.where(ranked.valid[:, 0], ranked.j[:, 0], -1)
    for name, radius in (("1m", 1.0), ("0.3m", 0.3), ("paper", travelled * PAPER_RADIUS)):
        pairs = facing_pairs(truth[result.keyframes], centre_m, radius)
        share, queries = recall_at_1(first, ranked.opposing[:, 0], pairs)
        key = "paper_recall" if name == "paper" else f"recall_at_1_{name}"
        metrics[key] = share
        metrics[f"{key}_queries"] = queries
        if name == "1m":
            right = pairs[np.arange(len(first)), np.maximum(first, 0)] & ranked.opposing[:, 0]
            later = ranked.valid[:, 0]
            metrics["p100_1m"] = precision_100(-ranked.distance[later, 0].astype(np.float64), right[later])
    return metrics


def write_outputs(config, sequence: Sequence, frames: Frames, result: Result, view, metrics, started: float) -> None:
    """Writes the run folder, whole or not at all."""
    candidates, kept = result.candidates, result.kept
    after = np.asarray(result.solution.poses)
    poses = matrices(after, like=sequence.odom_from_base)
    poses[:, 2, 3] = sequence.odom_from_base[:, 2, 3]
    chosen = np.flatnonzero(kept)
    seen = np.asarray(view.seen)
    floor = mosaic(
        iter(result.described.view), seen, np.asarray(view.floor_from_view, np.float64), after[result.keyframes],
        masks=iter(result.described.floor), metres_per_px=config.map_metres_per_px,
    )  # fmt: skip
    closures = np.stack([candidates.i[chosen], candidates.j[chosen]], 1)
    pngs = {
        "trajectory": trajectory_figure(sequence, after, closures),
        "floor_map": figures.floor_map(floor.image, floor.extent, after[:, :2], closures),
        "candidates": figures.candidates(
            np.stack([candidates.j, candidates.i], 1), 1 - candidates.distance, kept, len(sequence)
        ),
    }
    best = [match_figure(sequence, frames, result, view, k) for k in spread_rows(chosen, 3)]
    doubtful = np.flatnonzero(~kept & (candidates.inliers >= 12) & ~np.isin(result.reasons, _THINNED))
    rejected = [match_figure(sequence, frames, result, view, k) for k in spread_rows(doubtful, 2)]
    table = [
        [sequence.names[candidates.i[k]], sequence.names[candidates.j[k]],
         "the opposite side" if candidates.opposing[k] else "the same side", str(candidates.inliers[k]),
         str(candidates.total[k]), *map(float, candidates.i_from_j[k, :2]), float(np.degrees(candidates.i_from_j[k, 2]))]
        for k in chosen
    ]  # fmt: skip
    metrics["seconds"]["total"] = round(time.perf_counter() - started, 3)
    metrics["peak_memory_mb"] = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1)
    page = run_page(sequence.path.name, metrics, pngs, [f for f in best if f], [f for f in rejected if f], table)
    with whole_folder(config.out) as folder:
        write_tum(folder / "trajectory.tum", sequence.timestamps, poses, "base_link; starts at odometry's first pose")
        write_closures(folder / "loop_closures.csv", sequence, result)
        (folder / "pose_graph.g2o").write_text(
            format_g2o(dataclasses.replace(result.graph, poses=result.solution.poses))
        )
        (folder / "metrics.json").write_text(json.dumps(metrics, indent=2) + "\n")
        (folder / "floor_map.png").write_bytes(pngs["floor_map"])
        (folder / "trajectory.png").write_bytes(pngs["trajectory"])
        with whole_file(folder / "report.html") as file:
            file.write(report(page))
        dump_config(config, folder / "config.yaml")


_THINNED = ["a better closure is near on the path"]


def trajectory_figure(sequence: Sequence, after: np.ndarray, closures: np.ndarray) -> bytes:
    """Before, after and truth; with truth, each path aligned to it as its ATE is."""
    from ebjax.evaluation.trajectory import align_se2

    before = planar(sequence.odom_from_base)[:, :2]
    paths = [before, after[:, :2]]
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


def match_figure(sequence: Sequence, frames: Frames, result: Result, view, k: int) -> dict[str, Any] | None:
    """The raw images of a candidate with its matches, the earlier one turned by pi where the view is opposing."""
    from ebjax.geometry.homography import apply

    candidates = result.candidates
    i, j = int(candidates.i[k]), int(candidates.j[k])
    images = frames.load(i), frames.load(j)
    if images[0] is None or images[1] is None:
        return None
    points = []
    for frame, rows in ((i, result.verified.query[k]), (j, result.verified.reference[k])):
        keypoints = result.described.features.keypoints[np.searchsorted(result.keyframes, frame)][rows]
        points.append(np.asarray(apply(view.image_from_view, jnp.asarray(keypoints, jnp.float64))))
    used = np.asarray(result.verified.matched[k])
    caption = (
        f"{sequence.names[i]} and {sequence.names[j]}: {candidates.inliers[k]} of {candidates.total[k]} matches agree; "
        f"{result.reasons[k]}."
    )
    png = figures.matches(
        images[0][0], images[1][0], points[0][used], points[1][used], np.asarray(result.verified.inliers[k])[used],
        turn_second=bool(candidates.opposing[k]),
    )  # fmt: skip
    return {"png": png, "caption": caption}


def write_closures(path: Path, sequence: Sequence, result: Result) -> None:
    """Every verified candidate: where, how alike, what was measured, and whether and why it counts."""
    c = result.candidates
    sigma = np.sqrt(np.maximum(np.diagonal(c.covariance, axis1=1, axis2=2), 0))
    with open(path, "w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(
            "i j name_i name_j time_i_s time_j_s direction distance inliers matches x_m y_m theta_rad "
            "sigma_x_m sigma_y_m sigma_theta_rad measured_by kept reason".split()
        )
        for k in range(len(c.i)):
            i, j = int(c.i[k]), int(c.j[k])
            numbers = [f"{value:.6f}" for value in (*c.i_from_j[k], *sigma[k])]
            rows.writerow([
                i, j, sequence.names[i], sequence.names[j], f"{sequence.timestamps[i]:.6f}",
                f"{sequence.timestamps[j]:.6f}", "opposing" if c.opposing[k] else "same", f"{c.distance[k]:.6f}",
                c.inliers[k], c.total[k], *numbers, "depth" if result.by_depth[k] else "floor",
                int(result.kept[k]), result.reasons[k],
            ])  # fmt: skip


def print_summary(config: Config, metrics: dict[str, Any]) -> None:
    """A few lines: what was found, how good it is, where it is."""
    for name, why in metrics["broken_frames"].items():
        print(f"skipped {name}: {why}")
    if metrics["frames_without_odometry"]:
        print(f"left out {len(metrics['frames_without_odometry'])} frames without odometry")
    print(
        f"{metrics['frames']} frames, {metrics['keyframes']} looked at, {metrics['candidates']} candidates verified, "
        f"{metrics['closures_kept']} loop closures kept ({metrics['closures_opposing']} from opposing views)"
    )
    if truth := metrics.get("closures_against_truth"):
        print(
            f"closures within 5 cm and 1 degree of the truth: {truth['within_5cm_1deg']} of {truth['checked']}; "
            f"worst {truth['position_error_m']['max']:.3f} m, {truth['heading_error_deg']['max']:.2f} deg"
        )
    if metrics.get("recall_at_1_1m") is not None:
        print(
            f"R@1 m of the first candidate {metrics['recall_at_1_1m']:.3f} over {metrics['recall_at_1_1m_queries']} "
            f"queries; P100 {metrics['p100_1m']:.3f}"
        )
    if error := metrics.get("ate_rmse_m"):
        print(f"ATE rmse, SE(2)-aligned: {error['before']:.3f} m before, {error['after']:.3f} m after")
    print(
        f"{metrics['ms_per_frame']:.1f} ms a frame in the pipeline (compilation included where not cached), "
        f"{metrics['seconds']['total']:.1f} s in all, peak memory {metrics['peak_memory_mb']:.0f} MB"
    )
    print(f"{config.out}: report.html, trajectory.tum, loop_closures.csv, pose_graph.g2o, metrics.json, floor_map.png")


if __name__ == "__main__":
    run(main, Config)
