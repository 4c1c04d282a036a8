"""A video file as a log: its frames at the times that the file gives, found again by them."""

from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ebjax.io.images import BrokenFrame
from ebjax.io.logs.log import Images, Log
from ebjax.io.logs.mount_options import MOUNT
from ebjax.io.logs.video_frames import VideoFrames
from ebjax.io.logs.video_opencv import OpenCvVideo
from ebjax.io.logs.video_refusal import refuse_what_is_no_video
from ebjax.io.logs.video_source import Source, VideoFacts
from ebjax.io.logs.video_times import check_rate, clock, notes_of_end, rate_in_words, times_of_frames

NEED_AV = ("AV01", "av01")
EXTRA = 'pip install "ebjax[av]"'
MISSING = {
    "camera": "give --camera FILE, any calibration of this camera at this video mode",
    "mount": MOUNT,
    "odometry": "no odometry in a video: the run is measured by the floor, --motion floor",
    "depth": "none in a video",
}


def open_video(path: str | Path, *, frames_per_s: float | None = None) -> Log:
    """Opens a video for reading. Every frame is gone through once, for its time; none is kept.

    Args:
      path: any video that OpenCV decodes, or PyAV where it is installed.
      frames_per_s: the rate to use instead of the file's times.

    Raises:
      ValueError: not a video, cut off, without pictures, of one picture, or of a codec that needs PyAV; names the file.
    """
    path = Path(path)
    check_rate(frames_per_s)
    refuse_what_is_no_video(path)
    open_source, facts, times_read, size = _go_through(path)
    if len(times_read) < 2:
        raise ValueError(f"{path}: holds one picture only; give a video, or a folder of images")
    kept, timestamps, counted, notes = times_of_frames(path, times_read, facts, frames_per_s)
    if facts.turned_deg:
        words = f"turned by {facts.turned_deg} degrees clockwise, as its rotation tag asks"
        notes += (f"{path}: {words}; the calibration must be of pictures turned so, {size[0]}x{size[1]}",)
    names = tuple(clock(time) for time in timestamps.tolist())
    frames = VideoFrames(open_source, times_read[kept], counted)
    return Log(
        path=path,
        kind="video",
        colour=Images(str(path), names, timestamps, partial(_decode, path, names, size, frames)),
        notes=notes + notes_of_end(path, times_read, facts),
        contents=(
            f"codec {facts.codec or 'unknown'}, {size[0]}x{size[1]}",
            f"{len(names)} frames, {rate_in_words(timestamps)}",
            f"duration {clock(float(timestamps[-1] - timestamps[0]))}",
        ),
        missing=dict(MISSING),
    )


Gone = tuple[Callable[[], Source], VideoFacts, Float[np.ndarray, " N"], tuple[int, int]]


def _go_through(path: Path) -> Gone:
    """Finds the decoder that gives pictures; returns it, facts, the time of every frame, and (width, height)."""
    by_opencv, by_av = partial(OpenCvVideo, path), partial(_open_av, path)
    silent = by_opencv().facts().codec in NEED_AV and find_spec("av") is not None
    found = None if silent else _frames_of(by_opencv)
    try:
        found = found or _frames_of(by_av)
    except ImportError:
        raise ValueError(f"{path}: OpenCV finds no picture that it can decode; {EXTRA} and try again") from None
    if found is None:
        raise ValueError(f"{path}: no frame in it can be decoded; record it again, or convert it to H.264 in MP4")
    return found


def _open_av(path: Path) -> Source:
    from ebjax.io.logs.video_av import PyAvVideo

    return PyAvVideo(path)


def _frames_of(open_source: Callable[[], Source]) -> Gone | None:
    source, times, size, facts = open_source(), list[float](), None, None
    while (time := source.grab()) is not None:
        if size is None and (image := source.image()) is not None:
            size, facts = (image.shape[1], image.shape[0]), source.facts()
        times.append(time)
    return None if size is None or facts is None else (open_source, facts, np.array(times), size)


def _decode(path: Path, names: tuple[str, ...], size: tuple[int, int], frames: VideoFrames, index: int) -> np.ndarray:
    image = frames.read(range(len(names))[index])
    if image is None:
        raise BrokenFrame(f"{path} at {names[index]}: the frame cannot be decoded; it is left out")
    if image.shape[:2] != size[::-1]:
        raise BrokenFrame(
            f"{path} at {names[index]}: {image.shape[1]}x{image.shape[0]}, not {size[0]}x{size[1]} pixels"
        )
    return image
