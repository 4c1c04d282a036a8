"""When the photographs of a folder were taken: from their names, from EXIF, or evenly spaced."""

import itertools
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ebjax.io.exif import Exif

SHAPES = (
    (re.compile(r"(\D*?)(\d+)\.(\d+)"), "seconds"),
    (re.compile(r"(\D*)(1\d{18})()"), "nanoseconds"),
    (re.compile(r"(\D*)(1\d{15})()"), "microseconds"),
)
PER_S = {"seconds": 1, "nanoseconds": 10**9, "microseconds": 10**6}


def times_in_names(folder: Path, paths: Sequence[Path]) -> tuple[list[Path], Float[np.ndarray, " N"], str] | None:
    """Takes file names for times where all of them are: 1305031102.175304.png, or 19 or 16 digits of a Unix time.

    Letters before the number may be there, the same in all names.

    Returns:
      The images in the order of their times, the times, s, and their unit; None where names are not times.

    Raises:
      ValueError: two images have the same time; names them.
    """
    for shape, unit in SHAPES:
        found = [shape.fullmatch(path.stem) for path in paths]
        if not all(found) or len({match[1] for match in found if match}) != 1:
            continue
        times = [
            int(match[2]) / PER_S[unit] + (float(f"0.{match[3]}") if match[3] else 0.0) for match in found if match
        ]
        order = sorted(range(len(times)), key=times.__getitem__)
        for a, b in itertools.pairwise(order):
            if times[a] == times[b]:
                raise ValueError(
                    f"{folder}: {paths[a].name} and {paths[b].name} have the same time; remove one of them"
                )
        return [paths[index] for index in order], np.array([times[index] for index in order]), unit
    return None


def times_of_photographs(
    folder: Path, exif: Sequence[Exif | None], frames_per_s: float | None
) -> tuple[Float[np.ndarray, " N"], str]:
    """Times of images whose names tell none: EXIF's where all have one and they increase, else evenly spaced.

    Args:
      folder: for messages.
      exif: of each image; None where it cannot be read.
      frames_per_s: the rate that the user gives, which goes before EXIF.

    Returns:
      Times, s, and a note that says where they come from.
    """
    if frames_per_s is not None:
        note = f"{folder}: the times are those of {frames_per_s:g} images/s, as given"
        return np.arange(len(exif)) / frames_per_s, note
    taken = [one.taken_s for one in exif if one is not None and one.taken_s is not None]
    if len(taken) == len(exif) and bool((np.diff(taken) > 0).all()):
        return np.array(taken), f"{folder}: the times are those of EXIF, DateTimeOriginal"
    why = "neither names nor EXIF tell the times"
    if len(taken) == len(exif):
        why = "the times of EXIF do not increase from image to image in the order of the names"
    elif taken:
        why = f"only {len(taken)} of {len(exif)} images have a time in EXIF"
    note = f"{folder}: {why}; 1 image/s is taken, give --frames-per-s if it is another rate"
    return np.arange(len(exif), dtype=np.float64), note
