"""A video read by OpenCV's FFmpeg. OpenCV turns the pictures by the rotation tag itself."""

from pathlib import Path

import cv2
from jaxtyping import UInt8
from numpy import ndarray

from ebjax.io.logs.video_source import VideoFacts
from ebjax.io.opencv_log import quiet


class OpenCvVideo:
    """A `Source`; without frames where OpenCV cannot open the file."""

    def __init__(self, path: Path):
        """Opens the file."""
        with quiet():
            self._capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)

    def facts(self) -> VideoFacts:
        """Returns what the file says of its video."""
        frames_per_s, frames = self._number(cv2.CAP_PROP_FPS), self._number(cv2.CAP_PROP_FRAME_COUNT)
        letters = int(self._number(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little").decode("ascii", "replace")
        return VideoFacts(
            codec="".join(letter for letter in letters if letter.isalnum()),
            frames_per_s=frames_per_s,
            declared_s=frames / frames_per_s if frames_per_s else 0.0,
            turned_deg=int(self._number(cv2.CAP_PROP_ORIENTATION_META)) % 360,
        )

    def _number(self, what: int) -> float:
        return max(self._capture.get(what), 0.0) if self._capture.isOpened() else 0.0

    def grab(self) -> float | None:
        """Goes on to the next frame and returns its time, s; None at the end."""
        return self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000 if self._capture.grab() else None

    def image(self) -> UInt8[ndarray, "H W 3"] | None:
        """Returns the frame that was grabbed last, RGB; None if it cannot be decoded."""
        try:
            whole, image = self._capture.retrieve()
        except cv2.error:
            return None
        return cv2.cvtColor(image, cv2.COLOR_BGR2RGB) if whole and image is not None else None  # type: ignore[return-value]

    def seek(self, time_s: float) -> None:
        """Jumps near a time: OpenCV makes a frame number of it, which is wrong at a variable rate."""
        self._capture.set(cv2.CAP_PROP_POS_MSEC, 1000 * time_s)
