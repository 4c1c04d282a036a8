"""Writes a log as the folder in TUM layout that `read_sequence` reads: whole or not at all, over several calls."""

import dataclasses
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Int

from ebjax.io.camera_file import CameraFile, write_camera
from ebjax.io.images import BrokenFrame, check_size
from ebjax.io.logs.log import Log
from ebjax.io.logs.open import LogOptions
from ebjax.io.timed_poses import nearest
from ebjax.io.trajectory import write_tum
from ebjax.logs.frame_bytes import DEPTH_SCALE, colour_bytes, depth_bytes
from ebjax.logs.working_folder import finish, put, source_state, working_folder
from ebjax.logs.written import Written

DEFAULT = LogOptions()


def check_out(out: Path, log: Path) -> None:
    """Refuses a folder that holds something, or lies in the log.

    Raises:
      ValueError: names it.
    """
    if out.is_file() or (out.is_dir() and any(out.iterdir())):
        raise ValueError(f"{out}: is there already; name another folder for --out, or remove it")
    if log.is_dir() and out.resolve().is_relative_to(log.resolve()):
        raise ValueError(f"{out}: lies in the log {log}; name a folder outside of it for --out")


def convert(
    log: Log,
    camera: CameraFile,
    out: Path,
    *,
    options: LogOptions = DEFAULT,
    max_time_difference_s: float = 0.02,
    progress: Callable[[Iterable[int], int], Iterable[int]] = lambda rows, total: rows,
) -> Written:
    """Writes images with the depth near them, all poses, and the camera. Stopped, the next call writes what is missing.

    Args:
      log: opened.
      camera: as it is mounted, of the log's images.
      out: the folder, not there yet or empty.
      options: what the log was opened with; a call with others starts anew.
      max_time_difference_s: how far apart in time an image and its depth image may be.
      progress: wraps the images' rows (iterable, total).

    Raises:
      ValueError: `out` holds something, or no image can be decoded.
      OSError: the folder cannot be written, or the disk is full; names the file.
    """
    check_out(out, log.path)
    log = log.fitting((camera.width, camera.height))
    state = {
        "log": source_state(log.path),
        "options": dataclasses.asdict(options),
        "max_time_difference_s": max_time_difference_s,
    }
    folder, found = working_folder(out, state)
    if found is not None:
        print(found, file=sys.stderr)
    writer = _Writer(log, camera, folder, Written(out))
    beside = _depth_rows(log, max_time_difference_s)
    try:
        for row in progress(range(len(log.colour)), len(log.colour)):
            writer.write(row, int(beside[row]))
    except KeyboardInterrupt:
        print(f"{out}: {len(writer.written.colour)} images are written; the same command goes on", file=sys.stderr)
        raise
    writer.end()
    finish(folder, out)
    return writer.written


class _Writer:
    """Writes frames that are not there yet, and at the end the lists of them."""

    def __init__(self, log: Log, camera: CameraFile, folder: Path, written: Written):
        self.log, self.camera, self.folder, self.written = log, camera, folder, written
        for kind in ("rgb", "depth") if log.depth is not None else ("rgb",):
            (folder / kind).mkdir(exist_ok=True)
        self.there = {file.stem: file.name for file in (folder / "rgb").iterdir()}

    def write(self, row: int, depth_row: int) -> None:
        colour, stamp = self.log.colour, f"{self.log.colour.timestamps[row]:.6f}"
        if stamp in self.written.colour:
            self.written.left_out.append(f"{colour.names[row]}: less than a microsecond after the image before")
            return
        try:
            if stamp not in self.there:
                content, suffix, rgb = colour_bytes(colour, row)
                check_size(f"{self.log.path}: {colour.names[row]}", rgb, (self.camera.width, self.camera.height))
                put(self.folder / "rgb" / f"{stamp}{suffix}", content)
                self.there[stamp] = f"{stamp}{suffix}"
            self.written.colour[stamp] = self.there[stamp]
            if self.log.depth is not None and depth_row >= 0:
                self.write_depth(depth_row)
        except BrokenFrame as fault:
            self.written.left_out.append(" ".join(str(fault).split()))

    def write_depth(self, row: int) -> None:
        assert self.log.depth is not None
        stamp = f"{self.log.depth.timestamps[row]:.6f}"
        path = self.folder / "depth" / f"{stamp}.png"
        if not path.exists():
            content, rounded_mm, too_far = depth_bytes(self.log.depth.decode(row))
            put(path, content)
            self.written.rounded_mm = max(self.written.rounded_mm, rounded_mm)
            self.written.too_far += too_far
        self.written.depth[stamp] = path.name

    def end(self) -> None:
        """Writes everything but the frames.

        Raises:
          ValueError: there is no frame.
        """
        folder, written = self.folder, self.written
        if not written.colour:
            faults = f"; first {written.left_out[0]}" if written.left_out else ""
            raise ValueError(f"{self.log.path}: none of its {len(self.log.colour)} images can be decoded{faults}")
        put(folder / "rgb.txt", _list("rgb", written.colour))
        if written.depth:
            put(folder / "depth.txt", _list("depth", written.depth))
        for name, poses in (("odometry", self.log.odometry), ("groundtruth", self.log.truth)):
            if poses is not None:
                write_tum(folder / f"{name}.txt", poses.timestamps, poses.poses)
        write_camera(folder / "camera.json", dataclasses.replace(self.camera, depth_scale=DEPTH_SCALE))
        if written.left_out:
            put(folder / "left_out.txt", "".join(f"{line}\n" for line in written.left_out).encode())


def _depth_rows(log: Log, max_time_difference_s: float) -> Int[np.ndarray, " N"]:
    """Of each image the depth image nearest in time, -1 where none is near."""
    stamps = log.colour.timestamps
    if log.depth is None or not len(log.depth):
        return np.full(len(stamps), -1)
    closest = nearest(log.depth.timestamps, stamps)
    return np.where(np.abs(log.depth.timestamps[closest] - stamps) <= max_time_difference_s, closest, -1)


def _list(folder: str, names: dict[str, str]) -> bytes:
    return "".join(f"{stamp} {folder}/{names[stamp]}\n" for stamp in sorted(names, key=float)).encode()
