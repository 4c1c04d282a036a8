"""A robot's run in TUM layout: rgb.txt, camera.json, odometry.txt; depth.txt and groundtruth.txt if there are any.

Reading lists no pixel: images are decoded when asked for, and a frame that cannot be decoded raises `BrokenFrame`.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, UInt8

from ebjax.io.camera_file import CameraFile, read_camera
from ebjax.io.images import BrokenFrame, depth_share, read_depth, read_image
from ebjax.io.poses import interpolate
from ebjax.io.text import check_increasing, data_lines, floats
from ebjax.io.trajectory import Trajectory, read_tum

__all__ = ["BrokenFrame", "CameraFile", "Sequence", "depth_share", "read_image", "read_sequence"]

MAX_GAP_S = 0.5


@dataclass(frozen=True)
class Sequence:
    """The frames of a run that have odometry, in time order.

    Attributes:
      path: the folder.
      names: the image files, as rgb.txt names them.
      timestamps: s.
      odom_from_base: odometry at the frames' times, metres.
      world_from_base: ground truth at the frames' times, NaN rows where there is none; None without groundtruth.txt.
      camera: what camera.json says.
      has_depth: whether depth was asked for and depth.txt is there.
      depth_names: the depth file of each frame, "" where none is near in time; empty without depth.
      dropped: (name, reason) of the frames left out while reading.
    """

    path: Path
    names: tuple[str, ...]
    timestamps: Float[np.ndarray, " N"]
    odom_from_base: Float[np.ndarray, "N 4 4"]
    world_from_base: Float[np.ndarray, "N 4 4"] | None
    camera: CameraFile
    has_depth: bool
    depth_names: tuple[str, ...]
    dropped: tuple[tuple[str, str], ...]

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


def nearest(times: Float[np.ndarray, " N"], queries: Float[np.ndarray, " M"]) -> np.ndarray:
    """Returns for each query the index of the nearest of the sorted times; there must be at least one."""
    after = np.clip(np.searchsorted(times, queries), 1, max(len(times) - 1, 1))
    if len(times) == 1:
        return np.zeros(len(queries), dtype=np.int64)
    return after - (queries - times[after - 1] <= times[after] - queries)


def poses_at(
    trajectory: Trajectory, times: Float[np.ndarray, " M"], max_time_difference_s: float, max_gap_s: float = MAX_GAP_S
) -> tuple[Float[np.ndarray, "M 4 4"], Bool[np.ndarray, " M"]]:
    """Evaluates a trajectory at given times, at a constant twist between its samples.

    Args:
      trajectory: timed poses.
      times: s.
      max_time_difference_s: how far the nearest sample may be where interpolation is not possible.
      max_gap_s: how far apart the two samples around a time may be to interpolate between them.

    Returns:
      The poses, NaN where there is none, and which there are.
    """
    stamps, poses = trajectory.timestamps, trajectory.poses
    closest = nearest(stamps, times)
    found = np.abs(stamps[closest] - times) <= max_time_difference_s
    result = np.where(found[:, None, None], poses[closest], np.nan)
    after = np.searchsorted(stamps, times, side="right")
    inside = np.flatnonzero((after > 0) & (after < len(stamps)))
    before, after = after[inside] - 1, after[inside]
    gap = stamps[after] - stamps[before]
    between = gap <= max_gap_s
    inside, before, after, gap = inside[between], before[between], after[between], gap[between]
    result[inside] = interpolate(poses[before], poses[after], (times[inside] - stamps[before]) / gap)
    found[inside] = True
    return result, found


def _check_files(folder: Path) -> None:
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder; a sequence is a folder with rgb.txt, camera.json and odometry.txt")
    for name in ("rgb.txt", "camera.json", "odometry.txt"):
        if not (folder / name).is_file():
            raise ValueError(f"{folder / name}: no such file; a sequence needs rgb.txt, camera.json and odometry.txt")


def read_sequence(
    path: str | Path, *, depth: bool = True, max_time_difference_s: float = 0.02, min_coverage: float = 0.9
) -> Sequence:
    """Reads the lists of a TUM-layout folder; see `Sequence`.

    Odometry and ground truth are interpolated between samples at most 0.5 s apart, or taken from the nearest sample.

    Args:
      path: the folder.
      depth: whether to look for depth.txt.
      max_time_difference_s: how far apart in time an image may be from its depth image or nearest pose.
      min_coverage: the share of frames that must have an odometry pose and, if depth.txt is there, a depth image.

    Raises:
      ValueError: a missing or malformed file, unsorted or duplicate timestamps, fewer than two frames, odometry or
        depth for too few frames; names the file, the line or key, and the remedy.
    """
    folder = Path(path)
    _check_files(folder)
    depth_file = folder / "depth.txt"
    has_depth = depth and depth_file.is_file()
    camera = read_camera(folder / "camera.json", depth=has_depth)
    names, times = _read_list(folder / "rgb.txt")
    if len(names) < 2:
        count = "one frame only" if names else "no frames"
        raise ValueError(f"{folder / 'rgb.txt'}: {count}; a run needs at least two lines `timestamp file`")

    odometry_file = folder / "odometry.txt"
    odom_from_base, found = poses_at(read_tum(odometry_file), times, max_time_difference_s)
    rule = f"within {max_time_difference_s:g} s or between two samples at most {MAX_GAP_S:g} s apart"
    if found.mean() < min_coverage or found.sum() < 2:
        raise ValueError(
            f"{odometry_file}: {found.sum()} of {len(names)} frames have an odometry pose {rule}; "
            f"at least {min_coverage:.0%} must: give the whole run's odometry, or set --min-coverage lower"
        )
    dropped = tuple((names[i], f"no odometry pose {rule}") for i in np.flatnonzero(~found))
    names, times, odom_from_base = tuple(names[i] for i in np.flatnonzero(found)), times[found], odom_from_base[found]

    world_from_base = None
    if (folder / "groundtruth.txt").is_file():
        world_from_base, known = poses_at(read_tum(folder / "groundtruth.txt"), times, max_time_difference_s)
        if not known.any():
            raise ValueError(
                f"{folder / 'groundtruth.txt'}: 0 of {len(names)} frames have a pose {rule}; "
                "correct its clock, or move the file away"
            )
    return Sequence(
        path=folder,
        names=names,
        timestamps=times,
        odom_from_base=odom_from_base,
        world_from_base=world_from_base,
        camera=camera,
        has_depth=has_depth,
        depth_names=_match_depth(depth_file, times, max_time_difference_s, min_coverage) if has_depth else (),
        dropped=dropped,
    )


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
