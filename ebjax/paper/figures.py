"""The pictures of the experiments, from runs and tables to what `ebjax.viz` draws."""

from collections.abc import Iterable, Mapping
from typing import Any

import cv2
import numpy as np

from ebjax.features.extractor import Extractor
from ebjax.features.pair import compare, extract, quad_view
from ebjax.features.record import matched_points
from ebjax.features.table import SIDE_PX, Pair
from ebjax.paper.drift import Closed, aligned
from ebjax.paper.pairs import facing_frames
from ebjax.paper.retrieval import BOTH, INPUTS, TURNED
from ebjax.paper.run import Run
from ebjax.slam.map import mosaic
from ebjax.viz import experiments
from ebjax.viz import figures as viz

COLUMNS = ("way out", "way back", "floor, way out", "floor, way back", "turned by pi")
VIEW_MARGIN = 0.5
DEFAULT = "floornet, correlation"


def _from_above(image: np.ndarray, run: Run) -> np.ndarray:
    height, width = run.view.size
    homography = np.asarray(run.view.image_from_view, np.float64)
    seen = np.asarray(run.view.seen)
    flags = cv2.INTER_AREA | cv2.WARP_INVERSE_MAP
    view = cv2.warpPerspective(image, homography, (width, height), flags=flags)
    return np.where(seen[..., None], view, 255).astype(np.uint8)


def floor_views(runs: Iterable[Run], names: Iterable[str]) -> bytes:
    """Figure 4: of every run a pair of facing images and their floor views."""
    rows = {}
    for run, name in zip(runs, names, strict=True):
        found = facing_frames(run, run.view.centre_m, 1)
        if not len(found):
            continue
        images = [run.sequence.rgb(int(frame)) for frame in found[0]]
        above = [_from_above(image, run) for image in images]
        rows[name] = (*images, *above, np.ascontiguousarray(above[1][::-1, ::-1]))
    return experiments.image_grid(rows, COLUMNS)


def matches(pair: Pair, chosen: Extractor) -> bytes:
    """Figure 5: matches of the floor views with R_pi, in the raw images."""
    view = quad_view(pair.quad, SIDE_PX, VIEW_MARGIN)
    a, b = extract(chosen, pair.image_a, view), extract(chosen, pair.image_b, view, turned=True)
    found = compare(a, b, view, model="homography", tolerance=0.01, seed=0)
    points_a, points_b, inliers = matched_points(found)
    title = f"{pair.name}: {found.inliers} of {found.total} matches agree; the second image is turned by pi"
    return viz.matches(pair.image_a, pair.image_b, points_a, points_b, inliers, turn_second=True, title=title)


def trajectory(closed: Closed) -> bytes:
    """Figure 6: odometry, corrected path and truth, each aligned as its ATE is."""
    truth, c = closed.run.truth, closed.result.candidates
    paths = [aligned(truth, path) for path in (closed.odometry, np.asarray(closed.result.solution.poses))]
    loops = np.stack([c.i, c.j], 1)[closed.result.kept]
    return viz.trajectory(paths[0], paths[1], truth[:, :2], loops)


def registered_maps(closed: Closed) -> bytes:
    """Figure 6: the floor laid out by odometry, by the corrected path and by the truth."""
    result, run = closed.result, closed.run
    panels, rows = {}, range(len(result.keyframes))
    for name, path in (
        ("odometry", closed.odometry),
        ("ours", np.asarray(result.solution.poses)),
        ("truth", run.truth),
    ):
        made = mosaic(
            map(result.seen, rows),
            np.asarray(run.view.seen),
            np.asarray(run.view.floor_from_view, np.float64),
            _upright(path, run.truth)[result.keyframes],
            masks=map(result.floor, rows),
        )
        panels[name] = (made.image, made.extent)
    return experiments.maps(panels)


def _upright(path: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """The path with its first pose where the truth's is."""
    turn = truth[0, 2] - path[0, 2]
    c, s = np.cos(turn), np.sin(turn)
    moved = (path[:, :2] - path[:1, :2]) @ np.array([[c, s], [-s, c]]) + truth[:1, :2]
    return np.concatenate([moved, path[:, 2:] + turn], 1)


def curves(table: Mapping[str, Mapping[str, Mapping[str, Any]]], names: Iterable[str]) -> bytes:
    """Precision over recall at 1 m, set by set: the default descriptor on every input, joint both ways, NetVLAD."""
    panels: dict[str, dict[str, tuple[np.ndarray, np.ndarray]]] = {}
    shown = {f"{DEFAULT}: {seen_as}": seen_as for seen_as in INPUTS}
    shown |= {row: row.split(":")[0] for row in table if row in (f"joint, correlation: {BOTH}", f"netvlad: {TURNED}")}
    for name in names:
        panels[name] = {}
        for row, label in shown.items():
            curve = table[row][name]["curve"]
            panels[name][label] = (np.array(curve["recall"]), np.array(curve["precision"]))
    return experiments.precision_over_recall(panels)
