"""The sizes that one image file can be read at, and how it is read for a camera: as stored, or turned as EXIF asks."""

from pathlib import Path

from ebjax.io.image_header import read_header
from ebjax.io.images import read_image

Size = tuple[int, int]


def sizes_of(path: Path) -> tuple[Size, ...]:
    """(width, height) as stored, px, and turned as its EXIF asks where that is another.

    Raises:
      BrokenFrame: it cannot be read.
    """
    header = read_header(path)
    if header is None:
        height, width = read_image(path).shape[:2]
        return ((width, height),)
    return tuple(dict.fromkeys((header.size, header.turned_size)))


def orientation_notes(path: Path, size: Size) -> tuple[str, ...]:
    """Says how an image that EXIF asks to be turned is read at a (width, height); nothing for others."""
    header = read_header(path)
    if header is None or not header.exif.turned:
        return ()
    turned = size != header.size and size == header.turned_size
    stored = "as stored, as a calibration is of stored pixels"
    how = "turned so, as only that has the camera's size" if turned else stored
    return (f"{path}: has the EXIF orientation {header.exif.orientation}; images are read {how}",)
