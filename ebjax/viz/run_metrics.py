"""What metrics.json says of a run, and the lines for the terminal."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from ebjax.evaluation.run import closure_errors, closure_summary, drift, reason_counts, trajectory_errors
from ebjax.io.sequence import Sequence
from ebjax.places.recall import judged_claims, precision_100
from ebjax.slam.run import Run
from ebjax.slam.why import why_nothing
from ebjax.slam.world import planar
from ebjax.viz.motion import motion_lines, motion_metrics

PAPER_RADIUS = 1 / 15


def run_metrics(sequence: Sequence, broken: Mapping[str, str], result: Run) -> dict[str, Any]:
    """What metrics.json says, times apart."""
    candidates, kept = result.candidates, result.kept
    before, wheels = result.path.everywhere(result.path.poses), path_before(sequence, result)
    travelled = float(np.linalg.norm(np.diff(wheels[:, :2], axis=0), axis=1).sum())
    joined = result.earlier.closures
    metrics: dict[str, Any] = {
        "sequence": str(sequence.path),
        "frames": len(sequence),
        "keyframes": len(result.keyframes),
        "travelled_m": round(travelled, 3),
        "depth": sequence.has_depth,
        "broken_frames": dict(broken),
        "frames_without_odometry": dict(sequence.dropped),
        "candidates": len(candidates.i),
        "closures_kept": int(kept.sum()),
        "closures_opposing": int((kept & candidates.opposing).sum()),
        "closures_by_depth": int((kept & result.by_depth).sum()),
        "reasons": reason_counts(result.reasons),
        "corrected_by_m": round(float(np.linalg.norm((wheels - result.poses)[:, :2], axis=1).max()), 4),
        "nothing_kept": None if kept.any() or joined else why_nothing(result.reasons, len(candidates.i)),
        "best_refused": None if kept.any() or joined else best_refused(sequence, result),
        "mirrored": result.mirrored,
        "map": None
        if not result.earlier.count
        else {"keyframes": result.earlier.count, "closures": joined, "in_map": result.earlier.in_map},
        "frames_followed": result.followed,
        "motion": None if result.motion is None else motion_metrics(result.motion),
        "scale_from_height_m": None
        if sequence.odom_from_base is not None or sequence.has_depth
        else round(float(sequence.camera.base_from_camera[2, 3]), 4),
        "odometry_tilt": None
        if result.lean is None
        else {"rms_deg": result.lean.rms_deg, "used": result.lean.used, "says": result.lean.says()},
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
    metrics |= trajectory_errors(truth, wheels, result.poses)
    if result.motion is not None:
        metrics |= {"drift": drift(truth, before)}
    errors = closure_errors(truth[candidates.i], truth[candidates.j], candidates.i_from_j)
    metrics |= closure_summary(errors, kept)
    first, opposing, distance = result.firsts.j, result.firsts.opposing, result.firsts.distance
    seen = truth[result.keyframes], result.view.centre_m
    for name, radius in (("1m", 1.0), ("0.3m", 0.3), ("paper", travelled * PAPER_RADIUS)):
        right, asked = judged_claims(*seen, radius, first, opposing)
        key = "paper_recall" if name == "paper" else f"recall_at_1_{name}"
        metrics[key] = float(right[asked].mean()) if asked.any() else None
        metrics[f"{key}_queries"] = int(asked.sum())
        metrics[f"{key}_radius_m"] = round(radius, 3)
        if name == "1m":
            valid = first >= 0
            metrics["p100_1m"] = precision_100(-distance[valid].astype(np.float64), right[valid])
    return metrics


def path_before(sequence: Sequence, result: Run) -> Float[np.ndarray, "F 3"]:
    """The odometry; without, the path that the floor's steps make."""
    if sequence.odom_from_base is None:
        return result.path.everywhere(result.path.poses)
    return planar(sequence.odom_from_base)


def best_row(result: Run) -> int | None:
    """The candidate with most agreeing matches; None where there is none."""
    return int(np.argmax(result.candidates.inliers)) if len(result.candidates.i) else None


def best_refused(sequence: Sequence, result: Run) -> str | None:
    """What the best candidate lacked, where none was kept."""
    k = best_row(result)
    if k is None:
        return None
    found = result.candidates
    pair = f"{sequence.names[found.i[k]]} and {sequence.names[found.j[k]]}"
    return f"the best candidate, {pair}: {found.inliers[k]} of {found.total[k]} matches agree; {result.reasons[k]}"


def brief_lines(metrics: Mapping[str, Any]) -> list[str]:
    """What happened, in two lines."""
    found = (
        f"{metrics['frames']} frames: {metrics['closures_kept']} loop closures kept of {metrics['candidates']} "
        f"candidates checked, {metrics['closures_opposing']} from opposing views"
    )
    if truth := metrics.get("closures_against_truth"):
        found += f"; {truth['within_5cm_1deg']} of {truth['checked']} are within 5 cm and 1 degree of the truth"
    if error := metrics.get("ate_rmse_m"):
        moved = f"the path was {error['before']:.4f} m off the truth, and is {error['after']:.4f} m off now (ATE rmse)"
    else:
        moved = metrics["nothing_kept"] or f"the path was corrected by up to {metrics['corrected_by_m']:.2f} m"
    return [found, f"{moved}; {metrics['seconds']['total']:.1f} s in all"]


def summary_lines(metrics: Mapping[str, Any]) -> list[str]:
    """What was found, and how good it is."""
    lines: list[str] = []
    for name, why in metrics["broken_frames"].items():
        lines.append(f"skipped {name}: {why}")
    if metrics["frames_without_odometry"]:
        lines.append(f"left out {len(metrics['frames_without_odometry'])} frames without odometry")
    lines.append(
        f"{metrics['frames']} frames, {metrics['keyframes']} looked at, {metrics['candidates']} candidates checked, "
        f"{metrics['closures_kept']} loop closures kept ({metrics['closures_opposing']} from opposing views)"
    )
    if metrics["frames_followed"]:
        followed, total = metrics["frames_followed"]
        lines.append(f"frame to frame: the floor measured {followed} of {total} steps")
    lines += motion_lines(metrics)
    if (height := metrics["scale_from_height_m"]) is not None:
        lines.append(f"scale: without wheels and depth all lengths rest on the camera's height of {height:.3f} m")
    if lean := metrics["odometry_tilt"]:
        lines.append(lean["says"])
    if there := metrics.get("map"):
        where = "in its frame" if there["in_map"] else "not joined to it: the trajectory is in the run's own frame"
        lines.append(f"map: {there['closures']} closures to its {there['keyframes']} keyframes; the run is {where}")
    if metrics["nothing_kept"]:
        lines.append(metrics["nothing_kept"])
        lines += [metrics["best_refused"]] if metrics["best_refused"] else []
    if metrics["mirrored"]:
        lines.append(metrics["mirrored"])
    if truth := metrics.get("closures_against_truth"):
        lines.append(
            f"closures within 5 cm and 1 degree of the truth: {truth['within_5cm_1deg']} of {truth['checked']}; "
            f"worst {truth['position_error_m']['max']:.3f} m, {truth['heading_error_deg']['max']:.2f} deg"
        )
    if metrics.get("recall_at_1_1m") is not None:
        lines.append(
            f"R@1 m of the first candidate {metrics['recall_at_1_1m']:.3f} over {metrics['recall_at_1_1m_queries']} "
            f"queries; P100 {metrics['p100_1m']:.3f}"
        )
    if apart := metrics.get("drift"):
        lines.append(
            f"drift before any closure, rms over {apart['stretch_m']:g} m: {100 * apart['position_share']:.2f} % of "
            f"the way, {apart['heading_deg_per_m']:.3f} degrees a metre"
        )
    if error := metrics.get("ate_rmse_m"):
        lines.append(f"ATE rmse, SE(2)-aligned: {error['before']:.4f} m before, {error['after']:.4f} m after")
    elif reason := metrics.get("ate_undefined"):
        lines.append(f"ATE is undefined: {reason}")
    lines.append(
        f"{metrics['ms_per_frame']:.1f} ms a frame in the pipeline (compilation included where not cached), "
        f"{metrics['seconds']['total']:.1f} s in all, peak memory {metrics['peak_memory_mb']:.0f} MB"
    )
    return lines
