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
from ebjax.odometry.floor_steps import measured
from ebjax.odometry.motion import Motion
from ebjax.odometry.wheels import WheelErrors
from ebjax.places.descriptor import descriptor
from ebjax.places.retrieve import LoopCandidates, comparable
from ebjax.places.search import check_ranking, search
from ebjax.posegraph.graph import PoseGraph
from ebjax.posegraph.levenberg import Solution
from ebjax.posegraph.lm import cut_off, solve
from ebjax.slam.describe import Described
from ebjax.slam.keyframes import Load, Progress
from ebjax.slam.lean import Lean
from ebjax.slam.path import Path as RunPath
from ebjax.slam.select import KEPT, Measured, SelectConfig, plausible, select
from ebjax.slam.travel import Recording, motion_config, travel
from ebjax.slam.verify import verify_pairs
from ebjax.views.run_view import RunView

Remember = Callable[[str, Path | None], Callable[[Callable], Callable]]
MIN_DEPTH_INLIERS = 8
CONTRADICTED = "contradicts the corrected path"


@dataclasses.dataclass(frozen=True)
class MountConfig:
    """How far the camera's mount is trusted."""

    refine: Literal["tilt", "all", "none"] = "tilt"
    """Which of it is estimated with the run and put right where the floor contradicts it: pitch and roll, or height and
    x too (where depth, or wheels with their declared --odometry.scale-sigma, tell them)."""


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
    motion: Literal["wheels+floor", "floor", "wheels"] | None = None
    """What measures the robot's steps; None: wheels+floor where the run has odometry, else floor. With wheels alone the
    camera's mount and the images' clock are taken as they are given."""
    seed: int = 0
    """Of the vocabulary and of RANSAC."""
    select: SelectConfig = dataclasses.field(default_factory=SelectConfig)
    odometry: WheelErrors = dataclasses.field(default_factory=WheelErrors)
    mount: MountConfig = dataclasses.field(default_factory=MountConfig)


@dataclasses.dataclass(frozen=True)
class Result:
    """What a run gave. Candidates are rows over `keyframes`; `candidates.i`, `.j` are frame numbers of the sequence.

    Attributes:
      keyframes: frame numbers that were looked at.
      described: their views and features.
      camera: with the mount that the run settled on.
      view: the floor view, under that camera.
      motion: how the robot moved between keyframes; None where wheels alone say it.
      ranked: the retrieval's candidates, rows and columns of `keyframes`.
      verified: matches of the verified candidates.
      candidates: verified candidates, measured.
      by_depth: whether depth measured them (else the metric floor).
      reasons: of each: "kept", or why not.
      path: what the closures corrected.
      graph: the path and the kept closures.
      solution: its optimum.
      poses: of all frames: x, y (m), heading (rad).
      seconds: of each stage.
      lean: how the robot leans, where something says so.
      followed: without wheels, how many frames the floor showed to follow on the one before, and of how many.
    """

    keyframes: Int[np.ndarray, " N"]
    described: Described
    camera: Camera
    view: RunView
    motion: Motion | None
    ranked: LoopCandidates
    verified: Verified
    candidates: Measured
    by_depth: Bool[np.ndarray, " K"]
    reasons: list[str]
    path: RunPath
    graph: PoseGraph
    solution: Solution
    poses: Float[np.ndarray, "F 3"]
    seconds: dict[str, float]
    lean: Lean | None = None
    followed: tuple[int, int] | None = None

    @property
    def kept(self) -> Bool[np.ndarray, " K"]:
        """Which candidates became loop closures."""
        return np.array([reason == KEPT for reason in self.reasons], bool)


def run(
    load: Load,
    timestamps: Float[np.ndarray, " F"],
    odom_from_base: Float[np.ndarray, "F 3"] | None,
    camera: Camera,
    view: RunView | Callable[[Camera], RunView],
    config: PipelineConfig,
    progress: Progress = lambda items, total, label: iter(items),
    remember: Remember | None = None,
    odometry_at: Callable[[float], Float[np.ndarray, "F 3"]] | None = None,
    ignored: Bool[np.ndarray, "H W"] | None = None,
    level_at: Callable[[float], Float[np.ndarray, "F 4 4"] | None] | None = None,
) -> Result:
    """Runs the pipeline on a whole sequence.

    Args:
      load: frame number -> (RGB uint8, depth in metres or None); None for a frame that cannot be read.
      timestamps: s, increasing.
      odom_from_base: x, y (m) and heading (rad) of every frame; None without wheels.
      camera: of the run.
      view: the floor it looks at, or what chooses it for a camera whose tilt was put right.
      config: see there.
      progress: wraps the long loop.
      remember: of a network's name and weights, gives what wraps its functions so that they look up what they know.
      odometry_at: (what is added to the images' stamps, s) -> odometry of every frame: the offset is then estimated.
      ignored: pixels of the image that are no world, such as the robot's own body.
      level_at: (what is added to the images' stamps, s) -> how the robot leans at every frame, by odometry, None where
        it does not say; used where the floor views agree.

    Raises:
      ValueError: fewer than two frames could be read; wheels are asked for and there is no odometry.
    """
    seconds: dict[str, float] = {}

    def stage(name: str, start: float) -> None:
        seconds[name] = time.perf_counter() - start

    if odom_from_base is None and config.motion not in (None, "floor"):
        raise ValueError(f"--motion {config.motion} needs odometry; run with --motion floor")
    networks = config.weights, config.arithmetic
    chosen, place = extractor(config.extractor, *networks), descriptor(config.descriptor, *networks)
    check_ranking(config.ranking, place.has_maps)
    if remember is not None and not chosen.jitted:
        chosen = remembered(chosen, remember(config.extractor, chosen.weights))
    if remember is not None and not place.jitted:
        place = dataclasses.replace(place, look=remember(config.descriptor, place.weights)(place.look))
    recording = Recording(load, timestamps, odom_from_base, odometry_at, ignored, level_at)
    view_of = view if callable(view) else lambda _: view
    found = travel(recording, camera, view_of, chosen, place, config, progress, seconds)
    keyframes, described, path = found.keyframes, found.described, found.path
    rows = np.searchsorted(path.frames, keyframes)

    start = time.perf_counter()
    travelled = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path.poses[:, :2], axis=0), axis=1))])
    allowed = comparable(
        jnp.asarray(timestamps[keyframes]), jnp.asarray(travelled[rows]), config.min_gap_s, config.min_gap_m
    )
    places = place.unite(described.place, seed=config.seed)
    ranked = jax.tree.map(np.asarray, search(places, allowed, ranking=config.ranking))
    stage("search", start)

    start = time.perf_counter()
    believable = plausible(
        rows[ranked.i],
        rows[ranked.j],
        path.poses,
        found.view.centre_m,
        found.view.extent_m,
        path.covariance,
        config.select.odometry_sigmas,
    )
    pick = best_of_each_direction(np.asarray(ranked.valid) & believable, np.asarray(ranked.opposing), config.verify)
    i, j, opposing, distance = (a[pick] for a in (ranked.i, ranked.j, ranked.opposing, ranked.distance))
    verified, floor, depth, with_depth, matches = verify_pairs(
        described, chosen, found.view, found.camera, i, j, opposing, tolerance_m=config.tolerance_m, seed=config.seed
    )
    inliers, total = (np.asarray(rows).sum(-1) for rows in (verified.inliers, verified.matched))
    if found.motion is None:
        by_depth = with_depth >= MIN_DEPTH_INLIERS
        i_from_j = np.where(by_depth[:, None], depth.i_from_j, floor.i_from_j).astype(np.float64)
        covariance = np.where(by_depth[:, None, None], depth.covariance, floor.covariance).astype(np.float64)
    else:
        agree = (inliers >= config.select.min_inliers) & (inliers >= config.select.min_inlier_ratio * total)
        found, matches = found.with_closures(matches, agree, i, j, motion_config(config, recording))
        described, path = found.described, found.path
        assert found.motion is not None
        i_from_j, covariance, by_depth = measured(matches, found.camera, config.tolerance_m, found.motion.trust_depth)
    candidates = Measured(
        keyframes[i],
        keyframes[j],
        opposing,
        distance,
        inliers,
        total,
        i_from_j,
        covariance,
    )
    stage("verify", start)

    start = time.perf_counter()
    ends = dataclasses.replace(candidates, i=rows[i], j=rows[j])
    reasons = select(ends, path.poses, path.covariance, config.select)
    kept = np.array([reason == KEPT for reason in reasons], bool)
    stage("select", start)

    start = time.perf_counter()
    graph = path.graph(candidates, kept)
    solution = solve(graph, kernel=config.kernel, width=config.kernel_width, max_steps=100)
    cut = cut_off(graph, solution.poses, kernel=config.kernel, width=config.kernel_width)
    if cut.any():
        for k in np.flatnonzero(kept)[cut[len(path.edges.i) :]]:
            reasons[k], kept[k] = CONTRADICTED, False
        graph = path.graph(candidates, kept)
    poses = path.everywhere(np.asarray(solution.poses))
    stage("pose graph", start)
    return Result(
        keyframes,
        described,
        found.camera,
        found.view,
        found.motion,
        ranked,
        verified,
        candidates,
        by_depth,
        reasons,
        path,
        graph,
        solution,
        poses,
        seconds,
        found.lean,
        found.followed,
    )


def best_of_each_direction(
    valid: Bool[np.ndarray, "N K"], opposing: Bool[np.ndarray, "N K"], count: int
) -> Bool[np.ndarray, "N K"]:
    """Marks the first `count` valid candidates of every view in each direction."""
    pick = np.zeros(valid.shape, bool)
    for way in (False, True):
        mine = valid & (opposing == way)
        pick |= mine & (np.cumsum(mine, axis=1) <= count)
    return pick
