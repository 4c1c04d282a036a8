"""How wrong a run is, against how wrong its own files say it is: its folder beside the true poses."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ebjax.evaluation.nees import between, pairs_along, summaries, tangent_errors, with_scale
from ebjax.evaluation.trajectory import arc_length
from ebjax.io.clocks import trajectory_in_seconds
from ebjax.io.json_text import parse_json
from ebjax.io.timed_poses import poses_at
from ebjax.io.trajectory import read
from ebjax.posegraph.g2o import read_g2o
from ebjax.posegraph.graph import components
from ebjax.posegraph.marginals import relative_marginals
from ebjax.slam.world import planar


def frames_and_truth(
    run: Path, reference_file: str, max_time_difference_s: float
) -> tuple[Float[np.ndarray, " F"], Float[np.ndarray, "F 3"], list[str]]:
    """Times of the run's frames, their true poses (x, y, heading), NaN where there is none, and how they were read."""
    frames, reference = read(run / "trajectory.tum"), read(reference_file)
    for file in (frames, reference):
        if not file.timed:
            raise ValueError(f"{file.path}: it has no times; give TUM rows `timestamp tx ty tz qx qy qz qw`")
    reference, converted = trajectory_in_seconds(reference, frames.timestamps)
    poses, found = poses_at(reference, frames.timestamps, max_time_difference_s)
    if found.sum() < 2:
        first, last = reference.timestamps[[0, -1]]
        raise ValueError(
            f"{reference_file}: from {first:.3f} to {last:.3f} s, it has a true pose for {found.sum()} of the run's "
            f"{len(found)} frames, from {frames.timestamps[0]:.3f} to {frames.timestamps[-1]:.3f} s; "
            "give the reference of this run, on the same clock"
        )
    return frames.timestamps, planar(poses), [*reference.notes, *converted]


def scale_sigma(run: Path) -> float:
    """How well a run says that its scale is known; 0 where it says nothing, as by wheels alone."""
    path = run / "metrics.json"
    if not path.exists():
        return 0.0
    try:
        motion = parse_json(path.read_text(encoding="utf-8"))["motion"] or {}
        found = float(motion.get("scale_sigma", 0.0))
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ValueError(f"{path}: it is damaged; take it from the run, or remove it") from error
    if not 0 <= found < 1:
        raise ValueError(f"{path}: scale_sigma {found} is no standard deviation; take it from the run, or remove it")
    return found


def relative_errors(
    run: Path, truth: Float[np.ndarray, "F 3"], distances: tuple[float, ...], most: int, scale: float
) -> dict[str, Any]:
    """NEES of relative poses by distance, from the marginals of the solved pose graph and the scale they share."""
    path = run / "pose_graph.g2o"
    graph, ids = read_g2o(path)
    rows = np.argsort(ids, kind="stable")
    strange = rows[(ids[rows] < 0) | (ids[rows] >= len(truth))]
    if graph.group != "se2" or len(strange):
        lack = "is not a planar graph" if graph.group != "se2" else f"has vertex {ids[strange[0]]}, no frame of the run"
        raise ValueError(f"{path}: it {lack}; take it from the run that wrote trajectory.tum")
    truth, poses = truth[ids[rows]], np.asarray(graph.poses)[rows]
    piece = components(len(graph.poses), np.asarray(graph.i), np.asarray(graph.j))[rows]
    path_m = arc_length(np.concatenate([poses[:, :2], np.zeros((len(poses), 1))], 1))
    results: dict[str, Any] = {}
    for distance in distances:
        a, b = pairs_along(path_m, np.isfinite(truth).all(1), distance, most)
        a, b = a[piece[a] == piece[b]], b[piece[a] == piece[b]]
        covariance = np.asarray(relative_marginals(graph, rows[a], rows[b], kernel="none"))
        if not np.isfinite(covariance).all() or (len(a) and (np.linalg.eigvalsh(covariance)[:, 0] <= 0).any()):
            raise ValueError(f"{path}: its marginals are not positive definite; correct the information of its edges")
        apart = between(poses[a], poses[b])
        covariance = with_scale(covariance, apart, scale)
        error = tangent_errors(apart, between(truth[a], truth[b]))
        results[f"{distance:g} m"] = summaries(error, covariance).get("all")
    return results
