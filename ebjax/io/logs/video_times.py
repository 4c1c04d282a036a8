"""The times of a video's frames: those of the file where they increase, else a rate."""

import math
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ebjax.io.logs.video_frames import SAME_S
from ebjax.io.logs.video_source import VideoFacts

ROUNDED_S = 0.0015
CONSTANT = 0.05
MOST_PER_S = 300


def check_rate(frames_per_s: float | None) -> None:
    """Checks a rate that the user gives.

    Raises:
      ValueError: not a positive number.
    """
    if frames_per_s is not None and not (math.isfinite(frames_per_s) and frames_per_s > 0):
        raise ValueError(f"--frames-per-s: {frames_per_s:g} is not a rate; give images a second, above 0")


def clock(time_s: float) -> str:
    """A time as people read it: 12.345 s is "0:12.345", 3723.5 s is "1:02:03.500"."""
    ms = round(1000 * time_s)
    hours, minutes, seconds = ms // 3_600_000, ms // 60_000 % 60, f"{ms // 1000 % 60:02d}.{ms % 1000:03d}"
    return f"{hours}:{minutes:02d}:{seconds}" if hours else f"{minutes}:{seconds}"


def times_of_frames(
    path: Path, read: Float[np.ndarray, " N"], facts: VideoFacts, frames_per_s: float | None
) -> tuple[Int[np.ndarray, " K"], Float[np.ndarray, " K"], bool, tuple[str, ...]]:
    """Decides which frames are used, and when they were taken.

    Args:
      path: of the video, for messages.
      read: the time of each frame as the file gives it, s.
      facts: what the file says.
      frames_per_s: the rate that the user gives.

    Returns:
      The frames used; their times, s; whether they must be counted, as the file's times do not tell them apart; notes.
    """
    rising = np.flatnonzero(read > np.maximum.accumulate(np.r_[-np.inf, read[:-1]]) + SAME_S)
    every = np.arange(len(read))
    if frames_per_s is not None:
        notes = (f"{path}: the times are those of {frames_per_s:g} frames/s, as given, not the file's",)
        return every, every / frames_per_s, len(rising) < len(read), notes
    if len(rising) == 1:
        if not 0 < facts.frames_per_s <= MOST_PER_S:
            raise ValueError(f"{path}: holds no times and no rate; give --frames-per-s")
        rate = f"{facts.frames_per_s:g} frames/s are taken, which may be a guess"
        return every, every / facts.frames_per_s, True, (f"{path}: holds no times; {rate}; give --frames-per-s",)
    if len(rising) == len(read):
        return every, read, False, ()
    lost = f"{len(read) - len(rising)} of {len(read)} frames are left out, as their times do not increase"
    return rising, read[rising], False, (f"{path}: {lost}; give --frames-per-s to use every frame",)


def rate_in_words(times: Float[np.ndarray, " N"], unit: str = "frames/s") -> str:
    """The rate of frames, constant or variable."""
    steps = np.diff(times)
    middle = float(np.median(steps))
    if np.abs(steps - middle).max() <= max(ROUNDED_S, CONSTANT * middle):
        return f"{(len(times) - 1) / (times[-1] - times[0]):.4g} {unit}, constant rate"
    return f"{1 / middle:.4g} {unit} (median), variable rate, {steps.min():.3f} to {steps.max():.3f} s apart"


def notes_of_end(path: Path, read: Float[np.ndarray, " N"], facts: VideoFacts) -> tuple[str, ...]:
    """Says if the frames end well before the file says that it does."""
    if not facts.frames_per_s:
        return ()
    end = max(float(read.max()), (len(read) - 1) / facts.frames_per_s) + 1 / facts.frames_per_s
    if end >= facts.declared_s - max(1.0, 0.05 * facts.declared_s):
        return ()
    words = f"the file says that it lasts {clock(facts.declared_s)}, but its frames end at {clock(end)}"
    return (f"{path}: {words}; the rest is cut off or damaged, copy it again",)
