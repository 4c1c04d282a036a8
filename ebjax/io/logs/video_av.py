"""A video read by PyAV, for codecs that OpenCV opens but cannot decode, as AV1. Needs the extra `av`."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from ebjax.io.logs.video_source import VideoFacts

MOST_DAMAGED = 1000


class PyAvVideo:
    """A `Source`; turns the pictures by the rotation tag as OpenCV does.

    Raises:
      ImportError: PyAV is not installed.
      ValueError: PyAV cannot open the file, or it has no video.
    """

    def __init__(self, path: Path):
        """Opens the file."""
        import av

        try:
            self._container = av.open(str(path), metadata_errors="replace")
        except (av.FFmpegError, OSError) as error:
            raise ValueError(f"{path}: not a video: {error.strerror or error}; give MP4, MOV, MKV or AVI") from None
        if not self._container.streams.video:
            raise ValueError(f"{path}: no video stream in it; give a video with pictures")
        self._broken = av.FFmpegError
        self._stream = self._container.streams.video[0]
        self._stream.thread_type = "AUTO"
        self._decoded: Iterator[Any] = self._container.decode(self._stream)
        self._frame: Any = None

    def facts(self) -> VideoFacts:
        """Returns what the file says of its video."""
        length = self._container.duration
        return VideoFacts(
            codec=self._stream.codec_context.codec.canonical_name,
            frames_per_s=float(self._stream.average_rate or 0),
            declared_s=(length or 0) / 1e6,
            turned_deg=-self._frame.rotation % 360 if self._frame is not None else 0,
        )

    def grab(self) -> float | None:
        """Goes on to the next frame and returns its time, s; None at the end. Damaged ones are passed over."""
        self._frame = None
        for _ in range(MOST_DAMAGED):
            try:
                self._frame = next(self._decoded, None)
                break
            except self._broken:
                self._decoded = self._container.decode(self._stream)
        if self._frame is None:
            return None
        if self._frame.pts is None:
            return 0.0
        return float((self._frame.pts - (self._stream.start_time or 0)) * self._frame.time_base)

    def image(self) -> UInt8[np.ndarray, "H W 3"] | None:
        """Returns the frame that was grabbed last, RGB; None if there is none."""
        if self._frame is None:
            return None
        image = self._frame.to_ndarray(format="rgb24")
        return np.ascontiguousarray(np.rot90(image, round(self._frame.rotation / 90)))

    def seek(self, time_s: float) -> None:
        """Jumps to the last key frame before a time."""
        start = self._stream.start_time or 0
        try:
            self._container.seek(start + int(time_s / (self._stream.time_base or 1)), stream=self._stream)
        except self._broken:
            self._decoded = iter(())
            return
        self._decoded = self._container.decode(self._stream)
