"""The two facts that are wanted of a picture's EXIF: which way up it is, and when it was taken."""

import calendar
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass

ORIENTATION, EXIF_FOLDER, TAKEN, TAKEN_FRACTION = 0x0112, 0x8769, 0x9003, 0x9291
SHORT, LONG, ASCII = 3, 4, 2


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
        """Whether the pixels are turned or mirrored when the picture is decoded."""
        return self.orientation != 1

    @property
    def sideways(self) -> bool:
        """Whether width and height change places then."""
        return self.orientation >= 5


def read_exif(tiff: bytes) -> Exif:
    """Reads the TIFF block of EXIF, which begins with II or MM. What is damaged counts as absent."""
    order = {b"II": "little", b"MM": "big"}.get(tiff[:2])
    if order is None:
        return Exif()
    first = _folder(tiff, int.from_bytes(tiff[4:8], order), order)  # type: ignore[arg-type]
    orientation, place = first.get(ORIENTATION), first.get(EXIF_FOLDER)
    inner = _folder(tiff, place, order) if isinstance(place, int) else {}
    return Exif(
        orientation=orientation if isinstance(orientation, int) and 1 <= orientation <= 8 else 1,
        taken_s=_seconds(inner.get(TAKEN), inner.get(TAKEN_FRACTION)),
    )


def _folder(tiff: bytes, place: int, order: str) -> Mapping[int, int | str]:
    """A TIFF folder's entries of one number or a text: tag -> value."""

    def number(at: int, size: int) -> int:
        return int.from_bytes(tiff[at : at + size], order)  # type: ignore[arg-type]

    values: dict[int, int | str] = {}
    for entry in range(place + 2, place + 2 + 12 * number(place, 2), 12):
        if entry + 12 > len(tiff):
            break
        tag, kind, count = number(entry, 2), number(entry + 2, 2), number(entry + 4, 4)
        if kind in (SHORT, LONG) and count == 1:
            values[tag] = number(entry + 8, 2 if kind == SHORT else 4)
        elif kind == ASCII:
            start = entry + 8 if count <= 4 else number(entry + 8, 4)
            values[tag] = tiff[start : start + count].split(b"\0")[0].decode("ascii", "replace")
    return values


def _seconds(moment: int | str | None, fraction: int | str | None) -> float | None:
    try:
        whole = calendar.timegm(time.strptime(str(moment).strip(), "%Y:%m:%d %H:%M:%S"))
    except ValueError:
        return None
    digits = re.fullmatch(r"\s*(\d+)\s*", str(fraction))
    return whole + (float(f"0.{digits[1]}") if digits else 0.0)
