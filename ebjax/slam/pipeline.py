"""The batch pipeline: frames and odometry in, loop closures and the corrected trajectory out.

    keyframes -> describe -> search -> verify and measure -> select -> pose graph

Numerical only: images come from a `load` function, results go back as arrays; files and figures are the command's part.
"""

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ebjax.features.extractor import extractor
from ebjax.features.remember import remembered
from ebjax.features.verify import Verified
from ebjax.geometry.camera import Camera
from ebjax.models.fast import Arithmetic
from ebjax.places.descriptor import descriptor
from ebjax.places.retrieve import LoopCandidates, comparable
from ebjax.places.search import check_ranking, search
from ebjax.posegraph.graph import PoseGraph, make_graph
from ebjax.posegraph.levenberg import Solution
from ebjax.posegraph.lm import cut_off, solve
from ebjax.slam.describe import Described
from ebjax.slam.keyframes import Load, Progress, describe_keyframes, moved_enough
from ebjax.slam.select import KEPT, Measured, Odometry, SelectConfig, plausible, select
from ebjax.slam.verify import verify_pairs
from ebjax.views.run_view import RunView

Remember = Callable[[str, Path | None], Callable[[Callable], Callable]]
MIN_DEPTH_INLIERS = 8
CONTRADICTED = "contradicts the corrected path"


@dataclasses.dataclass(frozen=True)
class PipelineConfig:
    """How loops are searched, verified and used."""

    descriptor: str = "floornet"
    """Global descriptor: floornet, rootsift-vlad, hog, joint (floor and whole image), or of a network whose weights are
    not ours netvlad, superpoint, resnet50 or vgg19 (flattened map), resnet50-pooled, vgg19-pooled."""
    ranking: Literal["auto", "correlation", "cosine"] = "auto"
    """Ranking of candidates: the paper's cosine of global descriptors, or shift-maximised correlation of floor maps
    (floornet and rootsift-vlad only, and their default)."""
    extractor: str = "floornet"
    """Local features: floornet, rootsift (upright, on corners), sift, orb, surf, or another network: superpoint, d2net,
    alike."""
    weights: Path | None = None
    """Of a network: its .safetensors file, or a folder of them; None: $EBJAX_WEIGHTS or ~/.cache/ebjax/weights."""
    arithmetic: Arithmetic = "exact"
    """Of a network: float32 convolutions, the same by Winograd's algorithm (equal to rounding), or in part bfloat16."""
    keyframe_m: float = 0.15
    """A frame is looked at when the robot has moved so far since the last one, m."""
    keyframe_deg: float = 10.0
    """... or turned so far, degrees."""
    min_gap_s: float = 5.0
    """A view is compared with views at least so much earlier, s."""
    min_gap_m: float = 4.0
    """... and, in the same direction, at least so much path earlier, m."""
    verify: int = 2
    """Candidates of each view that are verified in each direction, the best that odometry does not rule out."""
    tolerance_m: float = 0.02
    """Largest distance of matching points on the floor, m."""
    kernel: Literal[
        "cauchy", "none", "huber", "geman-mcclure", "dcs", "tls", "gnc-tls", "gnc-gm", "pcm", "consensus"
    ] = "consensus"
    """How the pose graph survives false closures among those selected, as in `ebjax.posegraph.solve`."""
    kernel_width: float | None = None
    """Width of that kernel, standard deviations; None is 1, and for those that cut off the 99.9 % point."""
    seed: int = 0
    """Of the vocabulary and of RANSAC."""
    select: SelectConfig = dataclasses.field(default_factory=SelectConfig)
    odometry: Odometry = dataclasses.field(default_factory=Odometry)


@dataclasses.dataclass(frozen=True)
class Result:
    """What a run gave. Candidates are rows over `keyframes`; `candidates.i`, `.j` are frame numbers of the sequence.

    Attributes:
      keyframes: frame numbers that were looked at.
      described: their views and features.
      ranked: the retrieval's candidates, rows and columns of `keyframes`.
      verified: matches of the verified candidates.
      candidates: verified candidates, measured.
      by_depth: whether depth measured them (else the metric floor).
      reasons: of each: "kept", or why not.
      graph: odometry and the kept closures.
      solution: its optimum.
      seconds: of each stage.
    """

    keyframes: Int[np.ndarray, " N"]
    described: Described
    ranked: LoopCandidates
    verified: Verified
    candidates: Measured
    by_depth: Bool[np.ndarray, " K"]
    reasons: list[str]
    graph: PoseGraph
    solution: Solution
    seconds: dict[str, float]

    @property
    def kept(self) -> Bool[np.ndarray, " K"]:
        """Which candidates became loop closures."""
        return np.array([reason == KEPT for reason in self.reasons], bool)


def run(
    load: Load,
    timestamps: Float[np.ndarray, " F"],
    odom_from_base: Float[np.ndarray, "F 3"],
    camera: Camera,
    view: RunView,
    config: PipelineConfig,
    progress: Progress = lambda items, total, label: iter(items),
    remember: Remember | None = None,
) -> Result:
    """Runs the pipeline on a whole sequence.

    Args:
      load: frame number -> (RGB uint8, depth in metres or None); None for a frame that cannot be read.
      timestamps: s, increasing.
      odom_from_base: x, y (m) and heading (rad) of every frame.
      camera: of the run.
      view: the floor it looks at.
      config: see there.
      progress: wraps the long loop.
      remember: of a network's name and weights, gives what wraps its functions so that they look up what they know.

    Raises:
      ValueError: fewer than two frames could be read.
    """
    seconds: dict[str, float] = {}

    def stage(name: str, start: float) -> None:
        seconds[name] = time.perf_counter() - start

    start = time.perf_counter()
    networks = config.weights, config.arithmetic
    chosen, place = extractor(config.extractor, *networks), descriptor(config.descriptor, *networks)
    check_ranking(config.ranking, place.has_maps)
    if remember is not None and not chosen.jitted:
        chosen = remembered(chosen, remember(config.extractor, chosen.weights))
    if remember is not None and not place.jitted:
        place = dataclasses.replace(place, look=remember(config.descriptor, place.weights)(place.look))
    frames = moved_enough(odom_from_base, config.keyframe_m, config.keyframe_deg)
    keyframes, described = describe_keyframes(load, frames, camera, view, chosen, place, progress)
    stage("describe", start)

    start = time.perf_counter()
    travelled = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(odom_from_base[:, :2], axis=0), axis=1))])
    allowed = comparable(
        jnp.asarray(timestamps[keyframes]), jnp.asarray(travelled[keyframes]), config.min_gap_s, config.min_gap_m
    )
    places = place.unite(described.place, seed=config.seed)
    ranked = jax.tree.map(np.asarray, search(places, allowed, ranking=config.ranking))
    stage("search", start)

    start = time.perf_counter()
    believable = plausible(
        keyframes[ranked.i],
        keyframes[ranked.j],
        odom_from_base,
        view.centre_m,
        view.extent_m,
        config.odometry,
        config.select.odometry_sigmas,
    )
    pick = best_of_each_direction(np.asarray(ranked.valid) & believable, np.asarray(ranked.opposing), config.verify)
    i, j, opposing, distance = (a[pick] for a in (ranked.i, ranked.j, ranked.opposing, ranked.distance))
    verified, floor, depth, with_depth = verify_pairs(
        described, chosen, i, j, opposing, tolerance_m=config.tolerance_m, seed=config.seed
    )
    by_depth = with_depth >= MIN_DEPTH_INLIERS
    candidates = Measured(
        keyframes[i],
        keyframes[j],
        opposing,
        distance,
        np.asarray(verified.inliers).sum(-1),
        np.asarray(verified.matched).sum(-1),
        np.where(by_depth[:, None], depth.i_from_j, floor.i_from_j).astype(np.float64),
        np.where(by_depth[:, None, None], depth.covariance, floor.covariance).astype(np.float64),
    )
    stage("verify", start)

    start = time.perf_counter()
    reasons = select(candidates, odom_from_base, config.odometry, config.select)
    kept = np.array([reason == KEPT for reason in reasons], bool)
    stage("select", start)

    start = time.perf_counter()
    graph = build_graph(odom_from_base, candidates, kept, config.odometry)
    solution = solve(graph, kernel=config.kernel, width=config.kernel_width, max_steps=100)
    cut = cut_off(graph, solution.poses, kernel=config.kernel, width=config.kernel_width)
    if cut.any():
        for k in np.flatnonzero(kept)[cut[len(odom_from_base) - 1 :]]:
            reasons[k], kept[k] = CONTRADICTED, False
        graph = build_graph(odom_from_base, candidates, kept, config.odometry)
    stage("pose graph", start)
    return Result(keyframes, described, ranked, verified, candidates, by_depth, reasons, graph, solution, seconds)


def best_of_each_direction(
    valid: Bool[np.ndarray, "N K"], opposing: Bool[np.ndarray, "N K"], count: int
) -> Bool[np.ndarray, "N K"]:
    """Marks the first `count` valid candidates of every view in each direction."""
    pick = np.zeros(valid.shape, bool)
    for way in (False, True):
        mine = valid & (opposing == way)
        pick |= mine & (np.cumsum(mine, axis=1) <= count)
    return pick


def build_graph(
    odom_from_base: Float[np.ndarray, "F 3"],
    candidates: Measured,
    kept: Bool[np.ndarray, " K"],
    odometry: Odometry,
) -> PoseGraph:
    """Odometry from frame to frame and the kept closures; the robust kernel applies to closures only."""
    frames = len(odom_from_base)
    heading = odom_from_base[:-1, 2]
    step = np.diff(odom_from_base, axis=0)
    c, s = np.cos(heading), np.sin(heading)
    local = np.stack([c * step[:, 0] + s * step[:, 1], c * step[:, 1] - s * step[:, 0], step[:, 2]], 1)
    steps = odometry.step_sigmas(odom_from_base)
    chain = np.einsum("na,ab->nab", steps**-2.0, np.eye(3))
    rows = np.arange(frames - 1)
    return make_graph(
        odom_from_base.astype(np.float64),
        np.concatenate([rows, candidates.i[kept]]),
        np.concatenate([rows + 1, candidates.j[kept]]),
        np.concatenate([local, candidates.i_from_j[kept]]).astype(np.float64),
        np.concatenate([chain, np.linalg.inv(candidates.covariance[kept])]).astype(np.float64),
        robust=np.concatenate([np.zeros(frames - 1, bool), np.ones(int(kept.sum()), bool)]),
    )
