"""What the files of a log's images say before the run: their size, how EXIF turns them, bits, and what is odd."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from ebjax.io.image_header import Header, read_header
from ebjax.io.images import COLOUR, BrokenFrame, read_fitting, read_stored, shared_bits
from ebjax.io.logs.log import Images

DECODED = 12
LOOKED_AT = 48


@dataclass(frozen=True)
class Survey:
    """What was found.

    Attributes:
      headers: of each file that was looked at; None where it cannot be read.
      size: (width, height) of most of them as stored, px.
      turned_size: of most of those that EXIF turns sideways, as turned; None where it turns none to another size.
      bits: how many of 16 bits they use in common; None where none has so many.
      notes: what is odd, a line each.
      turned: how many EXIF asks to turn or mirror, in words; empty where none.
      faults: what is wrong with those that cannot be read.
    """

    headers: tuple[Header | None, ...]
    size: tuple[int, int]
    turned_size: tuple[int, int] | None
    bits: int | None
    notes: tuple[str, ...]
    turned: str
    faults: tuple[str, ...] = ()


def spread(count: int, most: int) -> list[int]:
    """So many rows of `count`, evenly spread, the first and the last among them."""
    return sorted({round(row) for row in np.linspace(0, count - 1, min(most, count))}) if count else []


def survey(source: str, paths: Sequence[Path]) -> Survey:
    """Reads the headers of images, and decodes a dozen where they have more than 8 bits or alpha.

    Args:
      source: for messages.
      paths: of the images to look at.

    Raises:
      ValueError: none of them can be read; names the first and what is wrong with it.
    """
    faults: list[str] = []
    headers = [_header(path, faults) for path in paths]
    read = [header for header in headers if header is not None]
    if not read:
        raise ValueError(f"{source}: none of {len(paths)} images looked at can be read; first {faults[0]}")
    size = Counter(header.size for header in read).most_common(1)[0][0]
    sideways = Counter(header.turned_size for header in read if header.exif.sideways and header.turned_size != size)
    deep = [path for path, header in zip(paths, headers, strict=True) if header is not None and header.bits > 8]
    clear = [path for path, header in zip(paths, headers, strict=True) if header is not None and header.alpha]
    bits = shared_bits([deep[row] for row in spread(len(deep), DECODED)])
    notes = []
    if bits is not None:
        kept = "the upper 8 are used" if bits == 16 else f"{bits} are in use, scaled to 8 alike in all"
        notes.append(
            f"{source}: {len(deep)} of {len(read)} images looked at have more than 8 bits: of 16, {kept}; if they are "
            "depth, give the colour images"
        )
    if transparent := sum(_transparent(clear[row]) for row in spread(len(clear), DECODED)):
        words = "are transparent in places; what colour lies there is read"
        notes.append(f"{source}: {transparent} of {min(len(clear), DECODED)} images looked at {words}")
    asked = Counter(header.exif.orientation for header in read if header.exif.turned)
    kinds = " and ".join(str(orientation) for orientation in sorted(asked))
    return Survey(
        headers=tuple(headers),
        size=size,
        turned_size=sideways.most_common(1)[0][0] if sideways else None,
        bits=bits,
        notes=tuple(notes),
        turned=f"{asked.total()} of {len(read)} images looked at have the EXIF orientation {kinds}" if asked else "",
        faults=tuple(faults),
    )


def file_images(
    source: str, names: Sequence[str], paths: Sequence[Path], timestamps: Float[np.ndarray, " N"], found: Survey
) -> Images:
    """The images of files: as stored, and turned as their EXIF asks where that gives another size."""

    def images(size: tuple[int, int], notes: tuple[str, ...], turned: Images | None = None) -> Images:
        return Images(
            source=source,
            names=tuple(names),
            timestamps=timestamps,
            decode=lambda k: _read(paths[k], size, found.bits),
            files=tuple(paths),
            size=size,
            turned=turned,
            notes=notes,
        )

    if not found.turned:
        return images(found.size, ())
    stored = f"{source}: {found.turned}; they are read as stored, as a calibration is of stored pixels"
    if found.turned_size is None:
        return images(found.size, (stored,))
    width, height = found.turned_size
    upright = f"{source}: {found.turned}; they are read turned so, as the camera's shape is that of {width}x{height}"
    return images(found.size, (stored,), images(found.turned_size, (upright,)))


def _read(path: Path, size: tuple[int, int], bits: int | None) -> np.ndarray:
    image = read_fitting(path, size, bits)
    height, width = image.shape[:2]
    if (width, height) != size:
        raise BrokenFrame(f"{path}: {width}x{height} pixels, but most images have {size[0]}x{size[1]}; it is left out")
    return image


def _header(path: Path, faults: list[str]) -> Header | None:
    """A file's header; where it tells too little, what decoding it tells."""
    header = read_header(path)
    if header is not None and not (header.raw or header.animated or header.floats):
        return header
    try:
        image = read_stored(path, COLOUR)[0]
        if image.dtype not in (np.uint8, np.uint16):
            read_fitting(path)
    except BrokenFrame as fault:
        faults.append(str(fault))
        return None
    return Header(image.shape[1], image.shape[0], 8 * image.dtype.itemsize)


def _transparent(path: Path) -> bool:
    """Whether some pixel is not opaque."""
    try:
        image = read_stored(path, cv2.IMREAD_UNCHANGED)[0]
    except BrokenFrame:
        return False
    if image.ndim == 2 or image.shape[2] != 4:
        return False
    return bool(image[..., 3].min() < np.iinfo(image.dtype).max)
