"""A folder of images as a log: in the order of the times in their names, or of the names."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from ebjax.io.image_folder import list_images, unread_images
from ebjax.io.logs.image_survey import Survey, file_images, survey
from ebjax.io.logs.log import Log
from ebjax.io.logs.mount_options import MOUNT
from ebjax.io.logs.photograph_times import times_in_names, times_of_photographs
from ebjax.io.logs.video_times import check_rate, clock, rate_in_words

MISSING = {
    "camera": "give --camera FILE, any calibration of this camera at this size of images",
    "mount": MOUNT,
    "odometry": "no odometry in a folder of images: the run is measured by the floor, --motion floor",
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
    found = _surveyed(folder, paths)
    size = found.size
    if named and frames_per_s is None:
        timestamps = named[1]
        notes.append(f"{folder}: the times are the file names, in {named[2]}")
    else:
        timestamps, note = times_of_photographs(
            folder, [header.exif if header else None for header in found.headers], frames_per_s
        )
        notes.append(note)
    kinds = Counter(path.suffix.lower().lstrip(".") for path in paths)
    return Log(
        path=folder,
        kind="folder of images",
        colour=file_images(str(folder), [path.name for path in paths], paths, timestamps, found),
        notes=(*notes, *_notes_of(folder, found), *found.notes),
        contents=(
            f"{len(paths)} images ({', '.join(kinds)}), {size[0]}x{size[1]}",
            rate_in_words(timestamps, "images/s"),
            f"duration {clock(float(timestamps[-1] - timestamps[0]))}",
        ),
        missing=dict(MISSING),
    )


def _chosen(folder: Path) -> tuple[list[Path], list[str]]:
    """The colour images of a folder in natural order, and notes of those left out."""
    shown = list_images(folder)
    colour = [path for path in shown if "depth" not in path.name.lower()]
    if shown and not colour:
        raise ValueError(f"{folder}: all images are named 'depth'; give the folder of colour images, or rename them")
    if len(colour) < 2:
        raise ValueError(f"{folder}: {len(colour) or 'no'} image in it; a run needs two at least")
    left_out = len(shown) - len(colour)
    notes = [f"{folder}: {left_out} images named 'depth' are left out"] if left_out else []
    return colour, [*notes, *(f"{folder}: {unread}" for unread in (unread_images(folder),) if unread)]


def _surveyed(folder: Path, paths: Sequence[Path]) -> Survey:
    """What the images say; two can be read at least."""
    found = survey(str(folder), paths)
    if sum(header is not None for header in found.headers) < 2:
        raise ValueError(f"{folder}: fewer than two of its {len(paths)} images can be read; first {found.faults[0]}")
    return found


def _notes_of(folder: Path, found: Survey) -> list[str]:
    """Notes of images that are left out."""
    read, count = [header for header in found.headers if header is not None], len(found.headers)
    notes = []
    if found.faults:
        words = f"{len(found.faults)} of {count} images cannot be read; they are left out, first {found.faults[0]}"
        notes.append(f"{folder}: {words}")
    sizes = Counter(header.size for header in read)
    used = sizes.pop(found.size)
    if sizes:
        others = ", ".join(f"{count} of {width}x{height}" for (width, height), count in sizes.most_common(3))
        width, height = found.size
        notes.append(f"{folder}: {used} images of {width}x{height} pixels are used; {others} are left out")
    return notes
