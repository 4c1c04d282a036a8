"""A run of one's own that a task learns from: any log and any calibration that `ebjax.slam` takes."""

import dataclasses
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from ebjax.io.calibration.depth_scale import depth_scale_in
from ebjax.io.logs.camera import camera_of
from ebjax.io.logs.mount_options import MountOptions
from ebjax.io.logs.open import LogOptions, open_log
from ebjax.io.sequence import Sequence, read_sequence
from ebjax.io.timed_poses import MAX_GAP_S


@dataclasses.dataclass(frozen=True)
class OwnRun:
    """Where a run is, and how it is read."""

    sequence: Path | None = None
    """A log: folder in TUM layout (rgb.txt, camera.json, odometry.txt; depth.txt, groundtruth.txt), ROS bag (.bag,
    .db3, .mcap or their folder), RTAB-Map database, video, folder of images."""
    log: Annotated[LogOptions, tyro.conf.arg(name="")] = dataclasses.field(default_factory=LogOptions)
    camera: Path | None = None
    """A calibration file to use in place of the log's own: camera.json, or of ROS, Kalibr, OpenCV, COLMAP, ORB-SLAM,
    RealSense, EuRoC, RTAB-Map, Gyroflow."""
    mount: MountOptions = dataclasses.field(default_factory=MountOptions)
    depth: Literal["sequence", "none"] = "sequence"
    """Use the log's depth where it has any, or none."""
    max_time_difference_s: float = 0.02
    """How far apart in time an image may be from its depth image or pose, s."""
    time_offset_s: float = 0.0
    """Added to the images' stamps, s; `python -m ebjax.slam` tells which."""
    max_gap_s: float = MAX_GAP_S
    """How far apart two samples of the odometry may be to interpolate between them, s."""
    min_coverage: float = 0.9
    """Share of frames that must have odometry (and depth)."""


def open_run(options: OwnRun) -> Sequence:
    """Reads the run; its notes say how the camera was read too.

    Raises:
      ValueError, OSError: as `open_log`, `camera_of` and `read_sequence`; or no run is named.
    """
    if options.sequence is None:
        raise ValueError("sequence is not set: name a run with --sequence")
    depth = options.depth == "sequence"
    depth_scale = None if options.camera is None else depth_scale_in(options.camera)
    log = open_log(options.sequence, options.log, depth=depth, depth_scale=depth_scale)
    camera, remarks = camera_of(log, options.camera, options.mount)
    sequence = read_sequence(
        log,
        camera=camera,
        depth=depth,
        max_time_difference_s=options.max_time_difference_s,
        max_gap_s=options.max_gap_s,
        min_coverage=options.min_coverage,
        time_offset_s=options.time_offset_s,
    )
    return dataclasses.replace(sequence, notes=(*remarks, *sequence.notes))


def camera_source(options: OwnRun, sequence: Sequence) -> str:
    """What the camera was read from, for messages."""
    return str(options.camera or sequence.log.camera_source)


def log_flags(options: OwnRun) -> str:
    """The flags that read the same log again, as they are typed; empty where none was given."""
    return "".join(f" --{name} {shlex.quote(str(value))}" for name, value in _changed(LogOptions(), options.log, ""))


def _changed(default: Any, value: Any, prefix: str) -> Iterator[tuple[str, Any]]:
    for field in dataclasses.fields(value):
        one, usual = getattr(value, field.name), getattr(default, field.name)
        name = prefix + field.name.replace("_", "-")
        if dataclasses.is_dataclass(one):
            yield from _changed(usual, one, f"{name}.")
        elif one != usual:
            yield name, one
