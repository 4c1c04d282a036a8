"""EXIF's eight orientations, as turns of an image."""

import numpy as np


def upright(image: np.ndarray, orientation: int) -> np.ndarray:
    """The image (H x W or H x W x C) as EXIF asks it to be shown.

    Args:
      image: as stored.
      orientation: 1 to 8. 2 mirrored, 3 turned by 180 degrees, 4 upside down, 5 to 8 with width and height exchanged:
        5 transposed, 6 turned clockwise, 7 mirrored at the other diagonal, 8 turned counter-clockwise.
    """
    if orientation >= 5:
        image = image.swapaxes(0, 1)
    across, down = orientation in (2, 3, 6, 7), orientation in (3, 4, 7, 8)
    return np.ascontiguousarray(image[:: -1 if down else 1, :: -1 if across else 1])
