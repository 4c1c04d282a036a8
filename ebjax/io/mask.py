"""Masks of pixels that show no floor: from a file, or from the alpha channel of a run's own images.

Black is ignored and white is used, as in COLMAP and hloc. OpenVINS has it the other way round: invert its masks.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool

from ebjax.io.image_header import PNG_SIGNATURE
from ebjax.io.images import BrokenFrame, fitting, read_stored, same_shape
from ebjax.io.orientation import upright

SAMPLED = 12


def read_mask(path: str | Path, size: tuple[int, int]) -> tuple[Bool[np.ndarray, "H W"], tuple[str, ...]]:
    """Reads which pixels of the images to ignore: True where the mask is transparent, or black where it has no alpha.

    Black is below half of the mask's brightest value, so 0 and 1, 0 and 255, and JPEG serve alike; transparent is
    alpha below one half. A mask of the images' shape but another resolution is scaled to `size`; one with an EXIF
    orientation is turned where only so it has their shape.

    Args:
      path: PNG, JPEG or anything else that OpenCV decodes.
      size: (width, height) of the images.

    Returns:
      The mask, and what was converted, a line each.

    Raises:
      ValueError: unreadable, another shape than the images, or a mask that ignores everything or nothing.
    """
    path = Path(path)
    image, exif = read_stored(path, cv2.IMREAD_UNCHANGED)
    if not same_shape(_size(image), size) and exif.turned:
        image = upright(image, exif.orientation)
    ignored = _transparent(image)
    if ignored is None:
        brightness = image if image.ndim == 2 else image[..., :3].max(axis=2)
        ignored = ~(brightness >= max(float(brightness.max()), 1e-9) / 2)
    width, height = _size(image)
    if ignored.all() or not ignored.any():
        raise ValueError(
            f"{path}: ignores {'every pixel' if ignored.all() else 'no pixel'}; "
            "make it black (or transparent) where the images show no floor, white elsewhere"
        )
    if (width, height) == size:
        return ignored, ()
    if not same_shape((width, height), size):
        raise ValueError(
            f"{path}: {width}x{height} pixels, but the images have {size[0]}x{size[1]}; give a mask of that size"
        )
    scaled = cv2.resize(ignored.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST_EXACT) > 0
    return scaled, (f"{path}: a mask of {width}x{height} pixels, scaled to the images' {size[0]}x{size[1]}",)


def alpha_mask(paths: Sequence[str | Path], size: tuple[int, int]) -> Bool[np.ndarray, "H W"] | None:
    """Where the images themselves are transparent: in each of a dozen, spread over the run.

    None where an image has no alpha channel, or where no pixel or every pixel is transparent: such alpha says nothing.
    JPEG and RGB PNG are told by their headers. Unreadable images and those of another size are left out.

    Args:
      paths: images of one run.
      size: (width, height) of the images.
    """
    ignored = np.ones((size[1], size[0]), bool)
    chosen = np.unique(np.linspace(0, len(paths) - 1, min(SAMPLED, len(paths))).astype(int))
    for path in (Path(paths[i]) for i in chosen):
        try:
            if not _may_have_alpha(path):
                return None
            image = fitting(*read_stored(path, cv2.IMREAD_UNCHANGED), size)
        except (OSError, BrokenFrame):
            continue
        if image.shape[:2] == ignored.shape:
            transparent = _transparent(image)
            if transparent is None:
                return None
            ignored &= transparent
    return None if ignored.all() or not ignored.any() else ignored


def _size(image: np.ndarray) -> tuple[int, int]:
    return image.shape[1], image.shape[0]


def _transparent(image: np.ndarray) -> Bool[np.ndarray, "H W"] | None:
    """Pixels of alpha below one half; None where there is no alpha, or none of it is used."""
    if image.ndim == 2 or image.shape[2] != 4:
        return None
    opaque = np.iinfo(image.dtype).max if image.dtype.kind == "u" else 1.0
    transparent = 2.0 * image[..., 3] < opaque
    return transparent if transparent.any() else None


def _may_have_alpha(path: Path) -> bool:
    """Tells by the header alone where that suffices: for JPEG, PNG and PGM or PPM."""
    with path.open("rb") as file:
        head = file.read(26)
        if head[:8] != PNG_SIGNATURE:
            return head[:2] not in (b"\xff\xd8", b"P5", b"P6")
        # Colour types 4 and 6 have a channel of it, the others a chunk tRNS before the pixels or nothing.
        return head[25:26] in (b"\x04", b"\x06") or b"tRNS" in (head + file.read()).partition(b"IDAT")[0]
