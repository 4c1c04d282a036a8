"""A folder of images as a log: in the order of the times in their names, or of the names."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ebjax.io.image_folder import list_images
from ebjax.io.images import BrokenFrame, read_image
from ebjax.io.logs.image_header import Header, read_header
from ebjax.io.logs.log import Images, Log
from ebjax.io.logs.photograph_times import times_in_names, times_of_photographs
from ebjax.io.logs.video_times import check_rate, clock, rate_in_words

MISSING = {
    "camera": "give --camera FILE, any calibration of this camera at this size of images",
    "mount": "give --mount.height-m and --mount.pitch-deg",
    "odometry": "none in a folder of images: the run is measured by the floor, --motion floor",
    "depth": "none in a folder of images",
}


def open_images(path: str | Path, *, frames_per_s: float | None = None) -> Log:
    """Opens a folder of images for reading; of JPEG and PNG only the headers are read.

    Args:
      path: the folder.
      frames_per_s: the rate to use instead of times in names or EXIF.

    Raises:
      ValueError: not a folder, or fewer than two images that can be read in it; names it.
    """
    folder = Path(path)
    check_rate(frames_per_s)
    paths, notes = _chosen(folder)
    named = times_in_names(folder, paths)
    paths = named[0] if named else paths
    headers = [read_header(path) or _decoded(path) for path in paths]
    size = _most_frequent(folder, headers)
    if named and frames_per_s is None:
        timestamps = named[1]
        notes.append(f"{folder}: the times are the file names, in {named[2]}")
    else:
        timestamps, note = times_of_photographs(
            folder, [header.exif if header else None for header in headers], frames_per_s
        )
        notes.append(note)
    kinds = Counter(path.suffix.lower().lstrip(".") for path in paths)
    return Log(
        path=folder,
        kind="folder of images",
        colour=Images(
            source=str(folder),
            names=tuple(path.name for path in paths),
            timestamps=timestamps,
            decode=lambda index: _read(paths[index], size),
            files=tuple(paths),
        ),
        notes=(*notes, *_notes_of(folder, headers, size)),
        contents=(
            f"{len(paths)} images ({', '.join(kinds)}), {size[0]}x{size[1]}",
            rate_in_words(timestamps, "images/s"),
            f"duration {clock(float(timestamps[-1] - timestamps[0]))}",
        ),
        missing=dict(MISSING),
    )


def _chosen(folder: Path) -> tuple[list[Path], list[str]]:
    """The colour images of a folder in natural order, and a note of those left out."""
    shown = [path for path in list_images(folder) if not path.name.startswith(".")]
    colour = [path for path in shown if "depth" not in path.name.lower()]
    if shown and not colour:
        raise ValueError(f"{folder}: all images are named 'depth'; give the folder of colour images, or rename them")
    if len(colour) < 2:
        raise ValueError(f"{folder}: {len(colour) or 'no'} image in it; a run needs two at least")
    left_out = len(shown) - len(colour)
    return colour, [f"{folder}: {left_out} images named 'depth' are left out"] if left_out else []


def _decoded(path: Path) -> Header | None:
    """The size of an image whose header does not tell it; None where it cannot be decoded."""
    try:
        height, width = read_image(path).shape[:2]
    except BrokenFrame:
        return None
    return Header(width, height)


def _most_frequent(folder: Path, headers: Sequence[Header | None]) -> tuple[int, int]:
    sizes = Counter((header.width, header.height) for header in headers if header is not None)
    if sizes.total() < 2:
        raise ValueError(f"{folder}: fewer than two of its {len(headers)} images can be read; copy them again")
    return sizes.most_common(1)[0][0]


def _notes_of(folder: Path, headers: Sequence[Header | None], size: tuple[int, int]) -> list[str]:
    """Notes of images that are unlike what a user may expect."""
    read = [header for header in headers if header is not None]
    notes = []
    if broken := len(headers) - len(read):
        notes.append(f"{folder}: {broken} of {len(headers)} images cannot be read; they are left out")
    others = Counter((header.width, header.height) for header in read if (header.width, header.height) != size)
    if others:
        found = ", ".join(f"{count} of {width}x{height}" for (width, height), count in others.most_common(3))
        used = f"{len(read) - others.total()} images of {size[0]}x{size[1]} pixels are used"
        notes.append(f"{folder}: {used}; {found} are left out")
    if turned := sum(header.exif.turned for header in read):
        words = "are turned as their EXIF orientation asks; the calibration must be of images turned so"
        notes.append(f"{folder}: {turned} of {len(read)} images {words}")
    if deep := sum(header.bits > 8 for header in read):
        words = "have more than 8 bits, of which the upper 8 are used; if they are depth, give the colour images"
        notes.append(f"{folder}: {deep} of {len(read)} images {words}")
    return notes


def _read(path: Path, size: tuple[int, int]) -> np.ndarray:
    image = read_image(path)
    height, width = image.shape[:2]
    if (width, height) != size:
        raise BrokenFrame(f"{path}: {width}x{height} pixels, but most images have {size[0]}x{size[1]}; it is left out")
    return image
