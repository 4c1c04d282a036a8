"""Closes loops from opposing views on a run and corrects its trajectory."""

import contextlib
import dataclasses
import resource
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from ebjax.command import dump_config, progress, run
from ebjax.evaluation.run import spread_rows
from ebjax.features.landmarks import floor_error_m
from ebjax.floors.__main__ import render_sequence
from ebjax.floors.sequence import CorridorConfig
from ebjax.geometry.camera import Camera, FloorView, camera_from
from ebjax.io.atomic import whole_folder
from ebjax.io.cache import open_cache
from ebjax.io.calibration.depth_scale import depth_scale_in
from ebjax.io.frames import Frames
from ebjax.io.logs.camera import camera_of
from ebjax.io.logs.mount_options import MountOptions
from ebjax.io.logs.open import LogOptions, open_log
from ebjax.io.mask import alpha_mask, read_mask
from ebjax.io.sequence import Sequence, read_sequence, require_odometry
from ebjax.io.timed_poses import MAX_GAP_S
from ebjax.slam.pipeline import MountConfig, PipelineConfig, Remember, Result
from ebjax.slam.pipeline import run as run_pipeline
from ebjax.slam.select import SelectConfig
from ebjax.slam.world import planar
from ebjax.views.depth_floor import camera_from_depth
from ebjax.views.run_view import RunView, choose_floor, from_camera, from_quad, without
from ebjax.views.static_pixels import spread, static_pixels
from ebjax.views.tilted import tilt_of_poses
from ebjax.viz.rtabmap_copy import write_rtabmap_copy
from ebjax.viz.run_folder import write_run
from ebjax.viz.run_metrics import run_metrics, summary_lines

Quad = tuple[float, float, float, float, float, float, float, float]


@dataclasses.dataclass(frozen=True)
class Mount(MountConfig, MountOptions):
    """Where the camera sits on the robot, and how far that is trusted."""


@dataclasses.dataclass(frozen=True)
class Config(PipelineConfig):
    """Finds where the robot drove the other way over the same floor, and corrects its odometry with it."""

    select: Annotated[SelectConfig, tyro.conf.arg(name="")] = dataclasses.field(default_factory=SelectConfig)
    log: Annotated[LogOptions, tyro.conf.arg(name="")] = dataclasses.field(default_factory=LogOptions)
    mount: Mount = dataclasses.field(default_factory=Mount)
    sequence: tyro.conf.Positional[Path | None] = None
    """A log: folder in TUM layout (rgb.txt, camera.json, odometry.txt; depth.txt, groundtruth.txt), ROS bag (.bag,
    .db3, .mcap or their folder), RTAB-Map database, video, folder of images; None: a synthetic one."""
    out: Path = Path("runs/slam")
    """Folder for the results."""
    depth: Literal["sequence", "none"] = "sequence"
    """Measure loops by the sequence's depth where it has any, or by the metric floor alone."""
    camera: Path | None = None
    """A calibration file to use in place of the log's own: camera.json, as `python -m ebjax.train` calibrates one, or
    of ROS, Kalibr, OpenCV, COLMAP, ORB-SLAM, RealSense, EuRoC, RTAB-Map, Gyroflow."""
    floor: Literal["camera", "depth"] = "camera"
    """Where the floor lies: as the camera's mount says, or as a plane fitted to the depth images."""
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
    time_offset_s: float | Literal["auto"] = "auto"
    """Added to the images' stamps, s; auto: estimated from turning rates where the odometry tells it."""
    max_gap_s: float = MAX_GAP_S
    """How far apart two samples of the odometry may be to interpolate between them, s."""
    mask: Literal["auto", "none"] | Path = "auto"
    """Pixels that are no floor: an image, black or transparent there; auto: found over the run, where the picture never
    changes (the robot's own body, dirt), or transparent in the images themselves."""
    min_coverage: float = 0.9
    """Share of frames that must have odometry (and depth)."""
    min_readable: float = 0.5
    """Share of frames that must be readable; fewer end the run."""
    cache: Path | None = None
    """Folder where what networks make of every view stays for the next run; None: nowhere."""


def main(config: Config) -> None:
    """Reads, runs, writes."""
    started = time.perf_counter()
    if config.sequence is None:
        config = dataclasses.replace(config, sequence=config.out / "sequence")
        if not (config.out / "sequence" / "rgb.txt").is_file():
            print(f"no sequence given: rendering a synthetic corridor into {config.sequence}")
            render_sequence(CorridorConfig(), config.out / "sequence")
    assert config.sequence is not None
    deep = config.depth == "sequence"
    depth_scale = None if config.camera is None else depth_scale_in(config.camera)
    log = open_log(config.sequence, config.log, depth=deep, depth_scale=depth_scale)
    mounted, remarks = camera_of(log, config.camera, config.mount)
    sequence = read_sequence(
        log,
        camera=mounted,
        depth=deep,
        max_time_difference_s=config.max_time_difference_s,
        min_coverage=config.min_coverage,
        max_gap_s=config.max_gap_s,
        odometry=config.motion != "floor",
        time_offset_s=0.0 if config.time_offset_s == "auto" else config.time_offset_s,
    )
    frames = Frames(sequence)
    camera = camera_from(sequence.camera)
    if config.floor == "depth":
        camera = camera_by_depth(sequence, frames, camera)
    for note in (*remarks, *sequence.notes):
        print(note)
    ignored = ignored_pixels(config.mask, sequence)
    looking = partial(run_view, config, ignored)
    try:
        looking(camera)
    except ValueError as fault:
        raise ValueError(f"{config.camera or log.camera_source}: {fault}") from None

    odometry = None if sequence.odom_from_base is None else planar(sequence.odom_from_base)
    retimed = None
    if odometry is not None and config.time_offset_s == "auto":

        def retimed(offset: float) -> np.ndarray:
            return planar(require_odometry(sequence.at_offset(offset)))

    def leaning_at(offset: float) -> np.ndarray | None:
        at = sequence.at_offset(offset) if offset else sequence
        return None if at.odom_from_base is None else tilt_of_poses(at.odom_from_base)

    try:
        with contextlib.ExitStack() as at_end:
            known = remembering(config, at_end)
            result = run_pipeline(
                frames.both,
                sequence.timestamps,
                odometry,
                camera,
                looking,
                config,
                progress,
                known,
                retimed,
                ignored,
                leaning_at,
            )
    except ValueError as fault:
        if not frames.broken:
            raise
        first = next(iter(frames.broken.values()))
        raise ValueError(f"{log.colour.source}: {fault}; first {first}") from None
    check_images(config.min_readable, sequence, frames, result)
    if result.motion is not None and result.motion.offset.offset_s:
        sequence = sequence.at_offset(result.motion.offset.offset_s)
    metrics = run_metrics(sequence, frames.broken, result)
    metrics["seconds"] = {name: round(value, 3) for name, value in result.seconds.items()}
    metrics["ms_per_frame"] = round(1e3 * sum(result.seconds.values()) / len(sequence), 2)
    metrics["seconds"]["total"] = round(time.perf_counter() - started, 3)
    metrics["peak_memory_mb"] = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1)
    with whole_folder(config.out) as folder:
        write_run(folder, sequence, frames.both, result, metrics, config.map_metres_per_px)
        copied = write_rtabmap_copy(folder, config.out, sequence, result)
        dump_config(config, folder / "config.yaml")
    print("\n".join(summary_lines(metrics)))
    for line in (metrics["motion"] or {}).get("warnings", ()):
        print(f"warning: {line}", file=sys.stderr)
    steps = "" if metrics["motion"] is None else "steps.csv, "
    names = f"report.html, trajectory.tum, {steps}loop_closures.csv, pose_graph.g2o, metrics.json, floor_map.png"
    print(f"{config.out}: {names}")
    for line in copied:
        print(line)


def run_view(config: Config, ignored: np.ndarray | None, camera: Camera) -> RunView:
    """The floor that a camera looks at, as the options say, without ignored pixels."""
    if config.quad is not None:
        view = from_quad(camera, np.array(config.quad, np.float64).reshape(4, 2), config.quad_margin)
    elif config.view is not None:
        view = from_camera(camera, FloorView(*config.view, config.metres_per_px))
    else:
        view = from_camera(camera, choose_floor(camera, config.metres_per_px))
    return view if ignored is None else without(view, camera, ignored)


def ignored_pixels(mask: Literal["auto", "none"] | Path, sequence: Sequence) -> np.ndarray | None:
    """Pixels of the image that are no world: by a file, or found over the run (auto); None where there are none."""
    size = sequence.camera.width, sequence.camera.height
    if mask == "none":
        return None
    if mask != "auto":
        given, notes = read_mask(mask, size)
        for note in notes:
            print(note)
        return given
    if sequence.files and (clear := alpha_mask(sequence.files, size)) is not None:
        print(f"mask: {clear.mean():.0%} of the image is transparent and ignored")
        return clear
    way = np.arange(len(sequence), dtype=np.float64)
    if sequence.odom_from_base is not None:
        step = np.diff(planar(sequence.odom_from_base), axis=0)
        way = np.concatenate([[0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]) + np.abs(step[:, 2]))])
    images = [image for image in map(Frames(sequence).rgb, spread(way).tolist()) if image is not None]
    if not images:
        return None
    found = static_pixels(images)
    if not found.any():
        return None
    print(f"mask: {found.mean():.0%} of the image never changes and is ignored, as the robot's own body (--mask none)")
    return found


def remembering(config: Config, at_end: contextlib.ExitStack) -> Remember | None:
    """What looks up in --cache what networks made of a view; the last of what is new is written at the end."""
    if config.cache is None:
        return None
    folder = config.cache

    def remember(name: str, weights: Path | None) -> Callable[[Callable], Callable]:
        cache = open_cache(folder, name, weights, arithmetic=config.arithmetic, use="slam")
        at_end.callback(cache.flush)
        return cache.remember

    return remember


def camera_by_depth(sequence: Sequence, frames: Frames, camera: Camera) -> Camera:
    """The camera over the floor that the depth images show."""
    if not sequence.has_depth:
        raise ValueError(f"{sequence.path}: --floor depth needs a log with depth, and --depth sequence")
    chosen = spread_rows(np.arange(len(sequence)), 9)
    depths = [images[1] for images in map(frames.both, chosen.tolist()) if images is not None and images[1] is not None]
    try:
        camera, height_m, pitch_deg, roll_deg = camera_from_depth(depths, camera)
    except ValueError as fault:
        raise ValueError(f"{sequence.log.depth_source}: {fault}") from None
    print(f"floor from depth: camera {height_m:.3f} m above it, pitch {pitch_deg:.2f} deg, roll {roll_deg:.2f} deg")
    return camera


def check_images(min_readable: float, sequence: Sequence, frames: Frames, result: Result) -> None:
    """Refuses a run of which too little could be read; warns where depth and camera.json disagree about the floor."""
    asked = len(result.keyframes) + len(frames.broken)
    if len(result.keyframes) < min_readable * asked:
        raise ValueError(
            f"{sequence.log.colour.source}: {len(frames.broken)} of {asked} frames could not be read, "
            f"first {next(iter(frames.broken.values()))}; or set --min-readable lower"
        )
    if not sequence.has_depth:
        return
    if not (result.described.landmarks.range_m > 0).any():
        raise ValueError(
            f"{sequence.log.depth_source}: no depth on the floor in any of {len(result.keyframes)} frames "
            "(all zero or not finite); check depth_scale in camera.json, or run with --depth none"
        )
    error = floor_error_m(result.described.landmarks)
    if result.motion is None and error > 0.05:
        print(
            f"warning: depth sees the floor {error:.2f} m (median) off where T_base_camera puts it; "
            "correct camera.json, or try --floor depth",
            file=sys.stderr,
        )


if __name__ == "__main__":
    run(main, Config)
