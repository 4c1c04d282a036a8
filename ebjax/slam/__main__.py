"""Closes loops from opposing views on a run and corrects its trajectory; keeps it in a map's file where asked to."""

import contextlib
import dataclasses
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from ebjax.command import dump_config, run
from ebjax.evaluation.run import spread_rows
from ebjax.features.landmarks import floor_error_m
from ebjax.floors.sequence import CorridorConfig
from ebjax.io.atomic import whole_folder
from ebjax.io.cache import open_cache
from ebjax.io.frames import Frames
from ebjax.io.logs.mount_options import MountOptions
from ebjax.io.sequence import Sequence
from ebjax.mapping.export import export_run
from ebjax.mapping.kept_run import KeptRun, read_as
from ebjax.mapping.localised_run import localise_run
from ebjax.mapping.map_options import MapOptions, check_map_options, look_after
from ebjax.mapping.open_run import RunOptions, camera_source, open_run, recording_of
from ebjax.mapping.seen_floor import FloorOptions, camera_over_floor, ignored_pixels, view_chooser
from ebjax.mapping.watched import Watched
from ebjax.slam.believe import BeliefConfig
from ebjax.slam.config import MountConfig, PipelineConfig
from ebjax.slam.pipeline import run as run_pipeline
from ebjax.slam.run import Run
from ebjax.slam.walker import Remember
from ebjax.viz.live import Live
from ebjax.viz.rtabmap_copy import write_rtabmap_copy
from ebjax.viz.run_folder import write_run
from ebjax.viz.run_metrics import run_metrics, summary_lines
from ebjax.worlds.render import render_sequence

MOST_IN_MEMORY = 2000
"""A longer run without --map is kept in a temporary map while it is driven: a keyframe takes about 100 kB."""


@dataclasses.dataclass(frozen=True)
class Mount(MountConfig, MountOptions):
    """Where the camera sits on the robot, and how far that is trusted."""


@dataclasses.dataclass(frozen=True)
class Config(MapOptions, PipelineConfig, FloorOptions, RunOptions):
    """Finds where the robot drove the other way over the same floor, and corrects its odometry with it."""

    believe: Annotated[BeliefConfig, tyro.conf.arg(name="")] = dataclasses.field(default_factory=BeliefConfig)
    mount: Mount = dataclasses.field(default_factory=Mount)
    sequence: tyro.conf.Positional[Path | None] = None
    """A log: folder in TUM layout (rgb.txt, camera.json, odometry.txt; depth.txt, groundtruth.txt), ROS bag (.bag,
    .db3, .mcap or their folder), RTAB-Map database, video, folder of images; None: a synthetic one, or --map alone."""
    out: Path = Path("runs/slam")
    """Folder for the results."""
    map_metres_per_px: float = 0.02
    """Of the floor map, m."""
    min_readable: float = 0.5
    """Share of frames that must be readable; fewer end the run."""
    cache: Path | None = None
    """Folder where what networks make of every view stays for the next run; None: nowhere."""
    live: bool = False
    """Show the map, the path and the closures as they come, in rerun's viewer (extra viz)."""
    save_rrd: Path | None = None
    """Record the same into a file for rerun (extra viz)."""


def main(config: Config) -> None:
    """Reads, runs, writes; or looks after a map alone."""
    started = time.perf_counter()
    check_map_options(config, config.sequence)
    if config.sequence is None and config.map is not None:
        if config.live or config.save_rrd is not None:
            raise ValueError(f"--{'live' if config.live else 'save-rrd'} shows a run: name a LOG before --map")
        print("\n".join(look_after(config.map, config, config.out, config.map_metres_per_px)))
        return
    if config.sequence is None:
        config = dataclasses.replace(config, sequence=config.out / "sequence")
        if not (config.out / "sequence" / "rgb.txt").is_file():
            print(f"no sequence given: rendering a synthetic corridor into {config.sequence}")
            render_sequence(CorridorConfig(), config.out / "sequence")
    sequence = open_run(config, odometry=config.motion != "floor")
    for note in sequence.notes:
        print(note)
    camera, remarks = camera_over_floor(config, sequence)
    ignored, found = ignored_pixels(config.mask, sequence)
    for note in (*remarks, *found):
        print(note)
    view = view_chooser(config, ignored, camera, camera_source(config, sequence))
    frames = Frames(sequence)
    recording = recording_of(sequence, frames, ignored, timed=config.time_offset_s == "auto")
    if config.localise and config.map is not None:
        with contextlib.ExitStack() as at_end:
            known, folder = remembering(config, at_end), config.out
            seen = camera, view(camera)
            told = localise_run(config.map, recording, *seen, config, folder, start=config.start, remember=known)
        print("\n".join(told))
        return
    with contextlib.ExitStack() as at_end:
        live = watching(config, at_end)
        watched = at_end.enter_context(Watched(len(recording), live))
        kept = None
        if config.map is not None or len(recording) > MOST_IN_MEMORY:
            kept = at_end.enter_context(KeptRun(config.map, sequence, config, read_as(config)))
        known = remembering(config, at_end)
        try:
            result = run_pipeline(recording, camera, view, config, remember=known, keep=kept, watch=watched)
        except ValueError as fault:
            if not frames.broken or "could be read" not in str(fault):
                raise
            first = next(iter(frames.broken.values()))
            raise ValueError(f"{sequence.log.colour.source}: {fault}; first {first}") from None
        check_images(config.min_readable, sequence, frames, result)
        watched.concluded(result)
        write_results(config, sequence, frames, result, started)
        if kept is not None:
            kept.finished(result)


def write_results(config: Config, sequence: Sequence, frames: Frames, result: Run, started: float) -> None:
    """Writes --out and prints what was found."""
    if result.motion is not None and result.motion.offset.offset_s:
        sequence = sequence.at_offset(result.motion.offset.offset_s)
    metrics = run_metrics(sequence, frames.broken, result)
    metrics["seconds"] = {name: round(value, 3) for name, value in result.seconds.items()}
    metrics["ms_per_frame"] = round(1e3 * sum(result.seconds.values()) / len(sequence), 2)
    metrics["seconds"]["total"] = round(time.perf_counter() - started, 3)
    metrics["peak_memory_mb"] = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1)
    with whole_folder(config.out) as folder:
        floor = write_run(folder, sequence, frames.both, result, metrics, config.map_metres_per_px)
        exported = export_run(folder, config.out, sequence, result, floor)
        copied = write_rtabmap_copy(folder, config.out, sequence, result)
        dump_config(config, folder / "config.yaml")
    print("\n".join((*exported.notes, *summary_lines(metrics))))
    for line in (metrics["motion"] or {}).get("warnings", ()):
        print(f"warning: {line}", file=sys.stderr)
    steps = "" if metrics["motion"] is None else "steps.csv, "
    names = f"report.html, trajectory.tum, {steps}loop_closures.csv, pose_graph.g2o, metrics.json, floor_map.png"
    print(f"{config.out}: {', '.join((names, *exported.files))}")
    for line in copied:
        print(line)


def watching(config: Config, at_end: contextlib.ExitStack) -> Live | None:
    """What shows or records the run, where that is asked for."""
    if not config.live and config.save_rrd is None:
        return None
    return at_end.enter_context(Live(spawn=config.live, save=config.save_rrd))


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


def check_images(min_readable: float, sequence: Sequence, frames: Frames, result: Run) -> None:
    """Refuses a run of which too little could be read; warns where depth and camera.json disagree about the floor."""
    asked = len(result.keyframes) + len(frames.broken)
    if len(result.keyframes) < min_readable * asked:
        raise ValueError(
            f"{sequence.log.colour.source}: {len(frames.broken)} of {asked} frames could not be read, "
            f"first {next(iter(frames.broken.values()))}; or set --min-readable lower"
        )
    if not sequence.has_depth:
        return
    some = result.looked.stacked_landmarks(spread_rows(np.arange(len(result.keyframes)), 64))
    if not (some.range_m > 0).any():
        raise ValueError(
            f"{sequence.log.depth_source}: no depth on the floor in any of {len(result.keyframes)} frames "
            "(all zero or not finite); check depth_scale in camera.json, or run with --depth none"
        )
    error = floor_error_m(some)
    if result.motion is None and error > 0.05:
        print(
            f"warning: depth sees the floor {error:.2f} m (median) off where T_base_camera puts it; "
            "correct camera.json, or try --floor depth",
            file=sys.stderr,
        )


if __name__ == "__main__":
    run(main, Config)
