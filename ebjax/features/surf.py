"""SURF (Bay et al., CVIU 2008) by mahotas, the paper's third classical feature; `pip install "ebjax[surf]"`.

Its descriptors are not as steady as SURF's should be: an exact turn by pi changes them to a cosine of 0.82.
"""

import numpy as np
from jaxtyping import Array, Bool, Float
from mahotas.features.surf import surf

from ebjax.features.extractor import Extractor, unturned
from ebjax.features.matching import Features
from ebjax.features.opencv import COUNT, grey_bytes, strongest_rows

BEFORE_DESCRIPTOR = 6
"""Columns y, x, scale, score, sign of the Laplacian, angle."""


def extract(view: Float[Array, "H W 3"], seen: Bool[Array, "H W"]) -> Features:
    """SURF with estimated orientation, 64 numbers and the sign of the Laplacian, together of unit length."""
    image, mask = grey_bytes(view, seen)
    # It drops some of the points it is asked for, and knows no mask.
    rows = surf(image, max_points=4 * COUNT)
    y, x = rows[:, 0], rows[:, 1]
    rows = rows[mask[np.rint(y).astype(int), np.rint(x).astype(int)] > 0]
    # Bright and dark blobs never match: their sign is one more number, as large as all the others.
    descriptors = np.sqrt(0.5) * np.concatenate([rows[:, BEFORE_DESCRIPTOR:], rows[:, 4:5]], axis=1)
    return strongest_rows(rows[:, [1, 0]], rows[:, 3], descriptors, 65)


SURF = Extractor(extract, jitted=False, turn=unturned)
