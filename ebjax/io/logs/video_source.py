"""What a decoder of videos offers: frames one after another, each with its time, and rough jumps."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from jaxtyping import UInt8
from numpy import ndarray


@dataclass(frozen=True)
class VideoFacts:
    """What the file says of its video.

    Attributes:
      codec: its short name, as "avc1"; "" if unknown.
      frames_per_s: 0 where the file gives none.
      declared_s: how long the file says it is; 0 where it says nothing.
      turned_deg: by how much the pictures are turned clockwise, as the rotation tag asks.
    """

    codec: str
    frames_per_s: float
    declared_s: float
    turned_deg: int


@runtime_checkable
class Source(Protocol):
    """An open video."""

    def facts(self) -> VideoFacts:
        """Returns what the file says of its video."""

    def grab(self) -> float | None:
        """Goes on to the next frame and returns its time, s from the start; None at the end."""

    def image(self) -> UInt8[ndarray, "H W 3"] | None:
        """Returns the frame that was grabbed last, RGB, turned by the rotation tag; None if it cannot be decoded."""

    def seek(self, time_s: float) -> None:
        """Jumps near a time; only the time of the next grab says where to."""
