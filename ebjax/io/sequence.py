"""A robot's run in TUM layout: rgb.txt and camera.json; odometry.txt, depth.txt and groundtruth.txt if there are any.

Reading decodes no image: images are decoded when asked for, and a frame that cannot be decoded raises `BrokenFrame`.
"""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from ebjax.io.camera_file import CameraFile, read_camera
from ebjax.io.images import BrokenFrame, depth_share, read_depth, read_image
from ebjax.io.text import check_increasing, data_lines, floats
from ebjax.io.timed_poses import MAX_BEYOND_S, MAX_GAP_S, nearest, poses_at, poses_everywhere, spacing
from ebjax.io.trajectory import Trajectory, read_tum
from ebjax.io.upright import floor_trajectory

__all__ = ["BrokenFrame", "CameraFile", "Sequence", "depth_share", "read_image", "read_sequence", "require_odometry"]


@dataclass(frozen=True)
class Sequence:
    """The frames of a run, in time order; those without odometry are left out, if there is odometry at all.

    Attributes:
      path: the folder.
      names: the image files, as rgb.txt names them.
      timestamps: s; the images' own stamps plus `time_offset_s`.
      odom_from_base: odometry at the frames' times, metres; None for a run without.
      world_from_base: ground truth at the frames' times, NaN rows where there is none; None without groundtruth.txt.
      camera: what camera.json says.
      has_depth: whether depth was asked for and depth.txt is there.
      depth_names: the depth file of each frame, "" where none is near in time; empty without depth.
      dropped: (name, reason) of the frames left out while reading.
      notes: what the user should know of how the files were read, a line each.
      odometry: all of odometry.txt as `odom_from_base` has it; None for a run without.
      truth: all of groundtruth.txt as `world_from_base` has it; None without.
      time_offset_s: what was added to the images' stamps.
      max_time_difference_s: as `read_sequence` was told.
      max_gap_s: as `read_sequence` was told.
    """

    path: Path
    names: tuple[str, ...]
    timestamps: Float[np.ndarray, " N"]
    odom_from_base: Float[np.ndarray, "N 4 4"] | None
    world_from_base: Float[np.ndarray, "N 4 4"] | None
    camera: CameraFile
    has_depth: bool
    depth_names: tuple[str, ...]
    dropped: tuple[tuple[str, str], ...]
    notes: tuple[str, ...] = ()
    odometry: Trajectory | None = None
    truth: Trajectory | None = None
    time_offset_s: float = 0.0
    max_time_difference_s: float = 0.02
    max_gap_s: float = MAX_GAP_S

    def __len__(self) -> int:
        """Returns the number of frames."""
        return len(self.names)

    def rgb(self, i: int) -> UInt8[np.ndarray, "H W 3"]:
        """Decodes the image of frame i; raises BrokenFrame (missing, truncated, wrong size), naming the file."""
        return read_image(self.path / self.names[i], (self.camera.width, self.camera.height))

    def depth(self, i: int) -> Float[np.ndarray, "H W"]:
        """Decodes the depth of frame i, float32 metres, 0 = missing; raises BrokenFrame, naming the file."""
        if not self.has_depth:
            raise ValueError(f"{self.path}: read without depth; it needs depth.txt")
        if not self.depth_names[i]:
            raise BrokenFrame(f"{self.path / self.names[i]}: depth.txt has no image near its time")
        size = (self.camera.width, self.camera.height)
        return read_depth(self.path / self.depth_names[i], self.camera.depth_scale, size)

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
      ValueError: the run has no odometry; names odometry.txt.
    """
    if sequence.odom_from_base is None:
        raise ValueError(
            f"{sequence.path / 'odometry.txt'}: {use} needs odometry, and the run was read without; "
            "give rows `timestamp tx ty tz qx qy qz qw`, the pose of base_link in the odometry's frame"
        )
    return sequence.odom_from_base


def _read_list(path: Path) -> tuple[tuple[str, ...], Float[np.ndarray, " N"]]:
    names, stamps = [], []
    for number, line in data_lines(path):
        fields = line.split(maxsplit=1)
        if len(fields) != 2:
            raise ValueError(f"{path} line {number}: {line!r} is not `timestamp file`; correct or remove the line")
        names.append(fields[1])
        stamps.append((number, floats(path, number, fields[:1])[0]))
    check_increasing(path, stamps)
    return tuple(names), np.array([stamp for _, stamp in stamps], dtype=np.float64)


def _check_files(folder: Path) -> None:
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder; a sequence is a folder with rgb.txt and camera.json")
    for name in ("rgb.txt", "camera.json"):
        if not (folder / name).is_file():
            raise ValueError(f"{folder / name}: no such file; a sequence needs rgb.txt and camera.json")


def read_sequence(
    path: str | Path,
    *,
    depth: bool = True,
    odometry: bool = True,
    max_time_difference_s: float = 0.02,
    max_gap_s: float = MAX_GAP_S,
    min_coverage: float = 0.9,
    time_offset_s: float = 0.0,
) -> Sequence:
    """Reads the lists of a TUM-layout folder; see `Sequence`.

    Odometry and ground truth are interpolated between two samples, or taken from the nearest sample. Without
    odometry.txt every frame is kept.

    Args:
      path: the folder.
      depth: whether to look for depth.txt.
      odometry: whether to look for odometry.txt.
      max_time_difference_s: how far apart in time an image may be from its depth image or nearest pose.
      max_gap_s: how far apart two samples may be to interpolate between them, at a constant twist.
      min_coverage: the share of frames that must have an odometry pose and, if depth.txt is there, a depth image.
      time_offset_s: added to the images' stamps before poses are looked up. Depth images are paired before that.

    Raises:
      ValueError: a missing or malformed file, unsorted or duplicate timestamps, fewer than two frames, odometry or
        depth for too few frames; names the file, the line or key, and the remedy.
    """
    folder = Path(path)
    _check_files(folder)
    depth_file, odometry_file, truth_file = (folder / f"{n}.txt" for n in ("depth", "odometry", "groundtruth"))
    has_depth = depth and depth_file.is_file()
    camera = read_camera(folder / "camera.json", depth=has_depth)
    names, stamps = _read_list(folder / "rgb.txt")
    if len(names) < 2:
        count = "one frame only" if names else "no frames"
        raise ValueError(f"{folder / 'rgb.txt'}: {count}; a run needs at least two lines `timestamp file`")
    rule = f"within {max_time_difference_s:g} s or between two samples at most {max_gap_s:g} s apart"
    notes: list[str] = []

    driven, odom_from_base = None, None
    dropped: tuple[tuple[str, str], ...] = ()
    if odometry and not _there(odometry_file):
        notes.append(f"{odometry_file}: no such file; the run is read without odometry")
    elif odometry:
        driven, remarks = floor_trajectory(read_tum(odometry_file), camera.base_from_camera)
        notes += remarks
        odom_from_base, found = poses_at(driven, stamps + time_offset_s, max_time_difference_s, max_gap_s)
        if found.mean() < min_coverage or found.sum() < 2:
            raise ValueError(
                f"{odometry_file}: {found.sum()} of {len(names)} frames have an odometry pose {rule}; at least "
                f"{min_coverage:.0%} must. {_spans(driven, stamps + time_offset_s)}: give the whole run's odometry, "
                "or set --max-gap-s higher or --min-coverage lower"
            )
        dropped = tuple((names[i], f"no odometry pose {rule}") for i in np.flatnonzero(~found))
        names, stamps = tuple(names[i] for i in np.flatnonzero(found)), stamps[found]
        odom_from_base = odom_from_base[found]

    truth, world_from_base = None, None
    if _there(truth_file):
        truth, remarks = floor_trajectory(read_tum(truth_file), camera.base_from_camera)
        notes += remarks
        world_from_base, known = poses_at(truth, stamps + time_offset_s, max_time_difference_s, max_gap_s)
        if not known.any():
            raise ValueError(
                f"{truth_file}: 0 of {len(names)} frames have a pose {rule}. "
                f"{_spans(truth, stamps + time_offset_s)}: correct its clock, or move the file away"
            )
    return Sequence(
        path=folder,
        names=names,
        timestamps=stamps + time_offset_s,
        odom_from_base=odom_from_base,
        world_from_base=world_from_base,
        camera=camera,
        has_depth=has_depth,
        depth_names=_match_depth(depth_file, stamps, max_time_difference_s, min_coverage) if has_depth else (),
        dropped=dropped,
        notes=tuple(notes),
        odometry=driven,
        truth=truth,
        time_offset_s=time_offset_s,
        max_time_difference_s=max_time_difference_s,
        max_gap_s=max_gap_s,
    )


def _there(path: Path) -> bool:
    return path.is_file() or Path(f"{path}.gz").is_file()


def _spans(trajectory: Trajectory, times: Float[np.ndarray, " N"]) -> str:
    return f"{spacing(trajectory)}; the images are from {times[0]:.3f} to {times[-1]:.3f} s"


def _match_depth(
    path: Path, times: Float[np.ndarray, " N"], max_time_difference_s: float, min_coverage: float
) -> tuple[str, ...]:
    names, stamps = _read_list(path)
    if not names:
        raise ValueError(f"{path}: no depth images; add lines `timestamp file`, or run with --depth none")
    closest = nearest(stamps, times)
    near = np.abs(stamps[closest] - times) <= max_time_difference_s
    if near.mean() < min_coverage:
        raise ValueError(
            f"{path}: {near.sum()} of {len(times)} frames have a depth image within {max_time_difference_s:g} s; "
            f"at least {min_coverage:.0%} must: set --max-time-difference-s or --min-coverage, or run with --depth none"
        )
    return tuple(names[j] if ok else "" for j, ok in zip(closest, near, strict=True))
