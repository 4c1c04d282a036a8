"""A robot's run: the frames of a log with the poses at their times, and the camera that took them.

Reading decodes no image: images are decoded when asked for, and a frame that cannot be decoded raises `BrokenFrame`.
"""

import dataclasses
import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

from ebjax.io.camera_file import CameraFile
from ebjax.io.clocks import overlap, seconds_text, time_range
from ebjax.io.depth_images import depth_share, fitted_depth
from ebjax.io.images import BrokenFrame, check_size, read_image
from ebjax.io.logs.camera import camera_of
from ebjax.io.logs.log import Images, Log
from ebjax.io.logs.log_clock import log_in_seconds
from ebjax.io.logs.open import open_log
from ebjax.io.timed_poses import MAX_BEYOND_S, MAX_GAP_S, nearest, poses_at, poses_everywhere, spacing
from ebjax.io.trajectory import Trajectory
from ebjax.io.upright import floor_trajectory

__all__ = ["BrokenFrame", "CameraFile", "Sequence", "depth_share", "read_image", "read_sequence", "require_odometry"]


@dataclass(frozen=True)
class Sequence:
    """The frames of a run, in time order; those without odometry are left out, if there is odometry at all.

    Attributes:
      log: they come from.
      rows: of the frames in `log.colour`.
      timestamps: s; the images' own stamps plus `time_offset_s`.
      odom_from_base: odometry at the frames' times, metres; None for a run without.
      world_from_base: ground truth at the frames' times, NaN rows where there is none; None without any.
      camera: of the images, as it is mounted.
      depth_rows: of the frames' depth in `log.depth`, -1 where none is near in time; None without depth.
      dropped: (name, reason) of the frames left out while reading.
      notes: what the user should know of how the log was read, a line each.
      odometry: all of it as `odom_from_base` has it; None for a run without.
      truth: all of it as `world_from_base` has it; None without.
      time_offset_s: what was added to the images' stamps.
      max_time_difference_s: as `read_sequence` was told.
      max_gap_s: as `read_sequence` was told.
    """

    log: Log
    rows: Int[np.ndarray, " N"]
    timestamps: Float[np.ndarray, " N"]
    odom_from_base: Float[np.ndarray, "N 4 4"] | None
    world_from_base: Float[np.ndarray, "N 4 4"] | None
    camera: CameraFile
    depth_rows: Int[np.ndarray, " N"] | None = None
    dropped: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    odometry: Trajectory | None = None
    truth: Trajectory | None = None
    time_offset_s: float = 0.0
    max_time_difference_s: float = 0.02
    max_gap_s: float = MAX_GAP_S

    def __len__(self) -> int:
        """Returns the number of frames."""
        return len(self.rows)

    @property
    def path(self) -> Path:
        """Of the log."""
        return self.log.path

    @functools.cached_property
    def names(self) -> tuple[str, ...]:
        """Of the frames' images, as the log has them."""
        return tuple(self.log.colour.names[row] for row in self.rows)

    @functools.cached_property
    def files(self) -> tuple[Path, ...]:
        """Of the frames' images, where each is a file."""
        return tuple(self.log.colour.files[row] for row in self.rows) if self.log.colour.files else ()

    @property
    def has_depth(self) -> bool:
        """Whether depth was asked for and is there."""
        return self.depth_rows is not None

    def rgb(self, i: int) -> UInt8[np.ndarray, "H W 3"]:
        """Decodes the image of frame i; raises BrokenFrame (missing, truncated, wrong size), naming it."""
        row = int(self.rows[i])
        image = self.log.colour.decode(row)
        check_size(self._file(row), image, (self.camera.width, self.camera.height))
        return image

    def depth(self, i: int) -> Float[np.ndarray, "H W"]:
        """Decodes the depth of frame i at the camera's size, float32 metres, 0 = missing; raises BrokenFrame."""
        if self.depth_rows is None or self.log.depth is None:
            raise ValueError(f"{self.path}: read without depth; it needs depth.txt, or another source of depth")
        if (row := int(self.depth_rows[i])) < 0:
            what = Path(self.log.depth.source).name
            raise BrokenFrame(f"{self._file(int(self.rows[i]))}: {what} has no image near its time")
        size = self.camera.width, self.camera.height
        return fitted_depth(f"{self.path}: {self.log.depth.names[row]}", self.log.depth.decode(row), size)

    def _file(self, row: int) -> str:
        colour = self.log.colour
        return str(colour.files[row]) if colour.files else f"{self.path}: {colour.names[row]}"

    def at_offset(self, time_offset_s: float) -> "Sequence":
        """The same frames with another offset added to their own stamps; poses are evaluated anew.

        No frame is lost: odometry is bridged whatever the gap, and its twist goes on for 1 s beyond its ends. Ground
        truth is NaN where `read_sequence` would have none.

        Raises:
          ValueError: a frame would lie more than 1 s outside the odometry.
        """
        times = self.timestamps - self.time_offset_s + time_offset_s
        # A frame may lie outside the odometry by the difference that is allowed without an offset.
        beyond_s = MAX_BEYOND_S + self.max_time_difference_s
        return dataclasses.replace(
            self,
            timestamps=times,
            time_offset_s=time_offset_s,
            odom_from_base=None if self.odometry is None else poses_everywhere(self.odometry, times, beyond_s),
            world_from_base=None
            if self.truth is None
            else poses_at(self.truth, times, self.max_time_difference_s, self.max_gap_s)[0],
        )


def require_odometry(sequence: Sequence, use: str = "this command") -> Float[np.ndarray, "N 4 4"]:
    """Returns `odom_from_base` of a run that must have it.

    Args:
      sequence: the run.
      use: what needs odometry, for the message.

    Raises:
      ValueError: the run has no odometry; says how to give it.
    """
    if sequence.odom_from_base is None:
        remedy = sequence.log.missing.get("odometry", "the run was read without")
        raise ValueError(f"{sequence.path}: {use} needs odometry, and {remedy}")
    return sequence.odom_from_base


def read_sequence(
    log: str | Path | Log,
    *,
    camera: CameraFile | None = None,
    depth: bool = True,
    odometry: bool = True,
    max_time_difference_s: float = 0.02,
    max_gap_s: float = MAX_GAP_S,
    min_coverage: float = 0.9,
    time_offset_s: float = 0.0,
) -> Sequence:
    """Puts together the frames of a log and the poses at their times; see `Sequence`.

    Odometry and ground truth are interpolated between two samples, or taken from the nearest sample. Without
    odometry every frame is kept.

    Args:
      log: a log, or its path.
      camera: in place of the log's own.
      depth: whether to look for depth.
      odometry: whether to look for odometry.
      max_time_difference_s: how far apart in time an image may be from its depth image or nearest pose.
      max_gap_s: how far apart two samples may be to interpolate between them, at a constant twist.
      min_coverage: the share of frames that must have an odometry pose and, if there is depth, a depth image.
      time_offset_s: added to the images' stamps before poses are looked up. Depth images are paired before that.

    Raises:
      ValueError: a missing or malformed file, unsorted or duplicate timestamps, no camera or no mount, fewer than two
        frames, odometry or depth for too few frames; names the file, the line or key, and the remedy.
    """
    log = log if isinstance(log, Log) else open_log(log, depth=depth)
    said: tuple[str, ...] = ()
    if camera is None:
        camera, said = camera_of(log)
    log = log_in_seconds(log.fitting((camera.width, camera.height)), time_offset_s)
    colour, stamps = log.colour, log.colour.timestamps
    if len(colour) < 2:
        count = "one frame only" if len(colour) else "no frames"
        raise ValueError(f"{colour.source}: {count}; a run needs at least two images")
    rule = f"within {max_time_difference_s:g} s or between two samples at most {max_gap_s:g} s apart"
    rows, notes = np.arange(len(colour)), [*log.notes, *said, *colour.notes]

    driven, odom_from_base = None, None
    dropped: tuple[tuple[str, str], ...] = ()
    if odometry and log.odometry is None:
        notes.append(f"{log.path}: {log.missing.get('odometry', 'no odometry')}")
    elif odometry and log.odometry is not None:
        driven, remarks = floor_trajectory(log.odometry, camera.base_from_camera)
        notes += remarks
        odom_from_base, found = poses_at(driven, stamps + time_offset_s, max_time_difference_s, max_gap_s)
        if found.mean() < min_coverage or found.sum() < 2:
            raise ValueError(
                f"{log.odometry.path}: {found.sum()} of {len(colour)} frames have an odometry pose {rule}; at least "
                f"{min_coverage:.0%} must. {_spans(driven, stamps + time_offset_s)}: "
                + (
                    _offset_hint(driven, stamps, max_time_difference_s, max_gap_s)
                    if overlap(driven.timestamps, stamps + time_offset_s) == 0
                    else "give the whole run's odometry, or set --max-gap-s higher or --min-coverage lower"
                )
            )
        dropped = tuple((colour.names[k], f"no odometry pose {rule}") for k in np.flatnonzero(~found))
        rows, odom_from_base = np.flatnonzero(found), odom_from_base[found]
    stamps = stamps[rows]

    truth, world_from_base = None, None
    if log.truth is not None:
        truth, remarks = floor_trajectory(log.truth, camera.base_from_camera)
        notes += remarks
        world_from_base, known = poses_at(truth, stamps + time_offset_s, max_time_difference_s, max_gap_s)
        if not known.any():
            raise ValueError(
                f"{log.truth.path}: 0 of {len(rows)} frames have a pose {rule}. "
                f"{_spans(truth, stamps + time_offset_s)}: {_truth_remedy(truth, stamps + time_offset_s)}"
            )
    paired = None
    if depth and log.depth is not None:
        paired = _match_depth(log.depth, stamps, max_time_difference_s, min_coverage)
    return Sequence(
        log=log,
        rows=rows,
        timestamps=stamps + time_offset_s,
        odom_from_base=odom_from_base,
        world_from_base=world_from_base,
        camera=camera,
        depth_rows=paired,
        dropped=dropped,
        notes=tuple(notes),
        odometry=driven,
        truth=truth,
        time_offset_s=time_offset_s,
        max_time_difference_s=max_time_difference_s,
        max_gap_s=max_gap_s,
    )


def _spans(trajectory: Trajectory, times: Float[np.ndarray, " N"]) -> str:
    return f"{spacing(trajectory)}; the images are from {time_range(times)}"


def _offset_hint(
    odometry: Trajectory, stamps: Float[np.ndarray, " N"], max_time_difference_s: float, max_gap_s: float
) -> str:
    """What to do where no frame lies within the odometry: the clocks differ, and only both starts can be compared."""
    offset = float(seconds_text(float(odometry.timestamps[0] - stamps[0])))
    found = int(poses_at(odometry, stamps + offset, max_time_difference_s, max_gap_s)[1].sum())
    return (
        f"the clocks differ. If both began at once, --time-offset-s {seconds_text(offset)}, added to the images' "
        f"times, pairs {found} of {len(stamps)}; else give the odometry of this run on the images' clock"
    )


def _truth_remedy(truth: Trajectory, times: Float[np.ndarray, " N"]) -> str:
    remedy = "move the file away"
    if overlap(truth.timestamps, times) > 0:
        return f"set --max-gap-s higher, or {remedy}"
    ahead = seconds_text(float(times[0] - truth.timestamps[0]))
    return f"the clocks differ. If both began at once, add {ahead} s to the times in it, or {remedy}"


def _match_depth(
    depth: Images, times: Float[np.ndarray, " N"], max_time_difference_s: float, min_coverage: float
) -> Int[np.ndarray, " N"]:
    if not len(depth):
        raise ValueError(f"{depth.source}: no depth images; add lines `timestamp file`, or run with --depth none")
    closest = nearest(depth.timestamps, times)
    near = np.abs(depth.timestamps[closest] - times) <= max_time_difference_s
    if near.mean() < min_coverage:
        remedy = "set --max-time-difference-s or --min-coverage, or run"
        if overlap(depth.timestamps, times) == 0:
            remedy = "the clocks differ; give depth images with the images' times, or run"
        raise ValueError(
            f"{depth.source}: {near.sum()} of {len(times)} frames have a depth image within {max_time_difference_s:g} "
            f"s; at least {min_coverage:.0%} must. Its times are {time_range(depth.timestamps)}, the images' "
            f"{time_range(times)}: {remedy} with --depth none"
        )
    return np.where(near, closest, -1)
