"""A folder of pairs of images of one floor with known homographies: one folder a pair, with a.*, b.* and gt.json."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ebjax.io.image_folder import SUFFIXES
from ebjax.io.image_kinds import SUFFIXES as UNREAD
from ebjax.io.image_kinds import conversion
from ebjax.io.json_text import parse_json
from ebjax.io.text import read_text

MOST = 1e12
"""Larger numbers, NaN too, are no pixels."""
VIEW_PX = 400
FORM = 'give "quad": four (x, y) px of a\'s floor, and "H_a_to_b": 3 x 3, px of a to px of b'
TRUTH = 'give "rms_px", px of a view of "top_size" (400 x 400), both above 0, or leave it out'


@dataclass(frozen=True)
class PairFiles:
    """Two images of one floor by one camera.

    Attributes:
      name: of the pair's folder.
      a: the first image.
      b: the second.
      quad: the floor in either image, (x, y) px: far left, far right, near right, near left.
      b_from_a: homography of the floor, px of a to px of b.
      truth_px: how far the points it was fitted to lie from it, rms, px of a view of the quad of 400 x 400 px; None
        where gt.json does not say so.
    """

    name: str
    a: Path
    b: Path
    quad: Float[np.ndarray, "4 2"]
    b_from_a: Float[np.ndarray, "3 3"]
    truth_px: float | None = None


def read_pairs(folder: str | Path) -> list[PairFiles]:
    """Reads the folders in `folder` that have a gt.json, by name.

    Raises:
      ValueError: there is none, an image of one is missing, or its gt.json has not the form above.
      OSError: the folder cannot be read.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise NotADirectoryError(20, "not a folder", str(folder))
    pairs = [_read_pair(path) for path in sorted(folder.glob("*/gt.json"))]
    if not pairs:
        raise ValueError(f"{folder}: no pair in it; give a folder of folders, each with a.png, b.png and gt.json")
    return pairs


def _read_pair(path: Path) -> PairFiles:
    text = read_text(path)
    try:
        values = parse_json(text)
        quad, homography = (np.array(values[key], np.float64) for key in ("quad", "H_a_to_b"))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{path}: {FORM} ({' '.join(str(error).split())[:100]})") from None
    small = all((np.abs(array) < MOST).all() for array in (quad, homography))
    if quad.shape != (4, 2) or homography.shape != (3, 3) or not small or abs(np.linalg.det(homography)) < 1e-12:
        raise ValueError(f"{path}: {FORM}")
    truth_px = _truth_px(path, values)
    return PairFiles(path.parent.name, _image(path, "a"), _image(path, "b"), quad, homography, truth_px)


def _truth_px(path: Path, values: dict[str, Any]) -> float | None:
    if values.get("rms_px") is None:
        return None
    try:
        given = np.array([values["rms_px"], *values.get("top_size", (VIEW_PX, VIEW_PX))], np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{path}: {TRUTH}") from None
    if given.shape != (3,) or not ((given > 0) & (given < MOST)).all():
        raise ValueError(f"{path}: {TRUTH}")
    return float(given[0] * VIEW_PX / given[1:].mean())


def _image(path: Path, side: str) -> Path:
    files = [file for file in sorted(path.parent.glob(f"{side}.*")) if not file.is_dir()]
    found = [file for file in files if file.suffix.lower() in SUFFIXES]
    if not found:
        unread = [file for file in files if file.suffix.lower().lstrip(".") in UNREAD]
        said = f"; {unread[0].name} is not read: {conversion(unread[0])}" if unread else ""
        raise ValueError(f"{path.parent}: no image {side}.png or {side}.jpg{said}")
    if len(found) > 1:
        raise ValueError(f"{path.parent}: both {found[0].name} and {found[1].name}; remove one of the two")
    return found[0]
