"""Opens a run: a log of any kind with its camera and odometry, and what the engine takes of it."""

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from jaxtyping import Bool, Float

from ebjax.io.calibration.depth_scale import depth_scale_in
from ebjax.io.frames import Frames
from ebjax.io.logs.camera import camera_of
from ebjax.io.logs.mount_options import MountOptions
from ebjax.io.logs.open import LogOptions, open_log
from ebjax.io.sequence import Sequence, read_sequence, require_odometry
from ebjax.io.timed_poses import MAX_GAP_S
from ebjax.slam.recording import Recording
from ebjax.slam.world import planar
from ebjax.views.tilted import tilt_of_poses


@dataclasses.dataclass(frozen=True)
class RunOptions:
    """Where a run is, and how it is read."""

    sequence: Path | None = None
    """A log: folder in TUM layout (rgb.txt, camera.json, odometry.txt; depth.txt, groundtruth.txt), ROS bag (.bag,
    .db3, .mcap or their folder), RTAB-Map database, video, folder of images."""
    log: Annotated[LogOptions, tyro.conf.arg(name="")] = dataclasses.field(default_factory=LogOptions)
    camera: Path | None = None
    """A calibration file to use in place of the log's own: camera.json, as `python -m ebjax.train` calibrates one, or
    of ROS, Kalibr, OpenCV, COLMAP, ORB-SLAM, RealSense, EuRoC, RTAB-Map, Gyroflow."""
    mount: MountOptions = dataclasses.field(default_factory=MountOptions)
    depth: Literal["sequence", "none"] = "sequence"
    """Use the log's depth where it has any, or none."""
    max_time_difference_s: float = 0.02
    """How far apart in time an image may be from its depth image or pose, s."""
    time_offset_s: float | Literal["auto"] = "auto"
    """Added to the images' stamps, s; auto: estimated from turning rates where the odometry tells it."""
    max_gap_s: float = MAX_GAP_S
    """How far apart two samples of the odometry may be to interpolate between them, s."""
    min_coverage: float = 0.9
    """Share of frames that must have odometry (and depth)."""


def open_run(options: RunOptions, *, odometry: bool = True) -> Sequence:
    """Reads the run; its notes say how the camera was read too.

    Args:
      options: see there.
      odometry: whether to look for it.

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
        odometry=odometry,
        max_time_difference_s=options.max_time_difference_s,
        max_gap_s=options.max_gap_s,
        min_coverage=options.min_coverage,
        time_offset_s=0.0 if options.time_offset_s == "auto" else options.time_offset_s,
    )
    return dataclasses.replace(sequence, notes=(*remarks, *sequence.notes))


def camera_source(options: RunOptions, sequence: Sequence) -> str:
    """What the camera was read from, for messages."""
    return str(options.camera or sequence.log.camera_source)


def flags_of(options: Any, prefix: str = "--") -> dict[str, Any]:
    """The fields of options, nested ones too, by the names of their flags."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(options):
        value, name = getattr(options, field.name), prefix + field.name.replace("_", "-")
        found |= flags_of(value, f"{name}.") if dataclasses.is_dataclass(value) else {name: value}
    return found


def recording_of(
    sequence: Sequence, frames: Frames, ignored: Bool[np.ndarray, "H W"] | None = None, *, timed: bool = False
) -> Recording:
    """The run as the engine takes it.

    Args:
      sequence: the run.
      frames: its images.
      ignored: pixels of the image that are no world.
      timed: whether what is added to the images' stamps may be estimated.
    """

    def odometry_at(offset_s: float) -> Float[np.ndarray, "F 3"]:
        return planar(require_odometry(sequence.at_offset(offset_s)))

    def level_at(offset_s: float) -> Float[np.ndarray, "F 4 4"] | None:
        poses = (sequence.at_offset(offset_s) if offset_s else sequence).odom_from_base
        return None if poses is None else tilt_of_poses(poses)

    poses = sequence.odom_from_base
    return Recording(
        frames.both,
        sequence.timestamps,
        None if poses is None else planar(poses),
        odometry_at if timed and poses is not None else None,
        ignored,
        level_at,
        sequence.names,
    )
