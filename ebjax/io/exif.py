"""The folder of tags that a TIFF begins with and EXIF is made of, and the two facts that are wanted of EXIF."""

import calendar
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass

ORIENTATION, EXIF_FOLDER, TAKEN, TAKEN_FRACTION = 0x0112, 0x8769, 0x9003, 0x9291
ASCII = 2
BYTES = {1: 1, 3: 2, 4: 4}
"""Bytes of a whole number by its type: byte, short, long."""
ORDERS = {b"II": "little", b"MM": "big"}


@dataclass(frozen=True)
class Exif:
    """What is wanted of EXIF.

    Attributes:
      orientation: 1 to 8, as EXIF counts; 1 is upright as stored.
      taken_s: DateTimeOriginal with its fraction, s since 1970 as if the camera's clock were UTC; None without.
    """

    orientation: int = 1
    taken_s: float | None = None

    @property
    def turned(self) -> bool:
        """Whether it asks to turn or mirror the stored pixels."""
        return self.orientation != 1

    @property
    def sideways(self) -> bool:
        """Whether width and height change places then."""
        return self.orientation >= 5


def read_exif(tiff: bytes) -> Exif:
    """Reads the TIFF block of EXIF, which begins with II or MM. What is damaged counts as absent."""
    first = tags(tiff)
    orientation, place = first.get(ORIENTATION), first.get(EXIF_FOLDER)
    inner = tags(tiff, place) if isinstance(place, int) else {}
    return Exif(
        orientation=orientation if isinstance(orientation, int) and 1 <= orientation <= 8 else 1,
        taken_s=_seconds(inner.get(TAKEN), inner.get(TAKEN_FRACTION)),
    )


def tags(tiff: bytes, place: int | None = None) -> Mapping[int, int | str]:
    """A TIFF folder's entries of a text or of numbers, of several the first: tag -> value.

    Args:
      tiff: from II or MM on.
      place: of the folder; None: the first.
    """
    order = ORDERS.get(tiff[:2])
    if order is None:
        return {}

    def number(at: int, size: int) -> int:
        return int.from_bytes(tiff[at : at + size], order)  # type: ignore[arg-type]

    values: dict[int, int | str] = {}
    place = number(4, 4) if place is None else place
    for entry in range(place + 2, place + 2 + 12 * number(place, 2), 12):
        if entry + 12 > len(tiff):
            break
        tag, kind, count = number(entry, 2), number(entry + 2, 2), number(entry + 4, 4)
        if kind in BYTES and count:
            size = BYTES[kind]
            values[tag] = number(entry + 8 if size * count <= 4 else number(entry + 8, 4), size)
        elif kind == ASCII:
            start = entry + 8 if count <= 4 else number(entry + 8, 4)
            values[tag] = tiff[start : start + count].split(b"\0")[0].decode("ascii", "replace")
    return values


def without_orientation(tiff: bytes) -> bytes:
    """A TIFF whose orientation is 1: decoders turn its pixels whether they are asked to or not."""
    order = ORDERS.get(tiff[:2])
    if order is None or read_exif(tiff).orientation == 1:
        return tiff
    place = int.from_bytes(tiff[4:8], order)  # type: ignore[arg-type]
    count = int.from_bytes(tiff[place : place + 2], order)  # type: ignore[arg-type]
    for entry in range(place + 2, place + 2 + 12 * count, 12):
        if int.from_bytes(tiff[entry : entry + 2], order) == ORIENTATION:  # type: ignore[arg-type]
            return tiff[: entry + 8] + (1).to_bytes(2, order) + tiff[entry + 10 :]  # type: ignore[arg-type]
    return tiff


def _seconds(moment: int | str | None, fraction: int | str | None) -> float | None:
    try:
        whole = calendar.timegm(time.strptime(str(moment).strip(), "%Y:%m:%d %H:%M:%S"))
    except ValueError:
        return None
    digits = re.fullmatch(r"\s*(\d+)\s*", str(fraction))
    return whole + (float(f"0.{digits[1]}") if digits else 0.0)
