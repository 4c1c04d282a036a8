"""Keyframes by row, as the engine counts them, and by id, as the map's file does: ids stay when a session is forgotten.

What was measured of a keyframe names the others that it was measured against. What names one that is gone is left out.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Int

from ebjax.slam.packed import Arrays

GONE = -1
TABLES = (("pairs.", "pairs.j", 1), ("candidates", "candidates", 1), ("steps.", "steps.ends", 2))
"""How the names of a table's arrays begin, the one that names keyframes, and in how many of its columns."""


def with_ids(kept: Arrays, ids: Int[np.ndarray, " N"]) -> dict[str, np.ndarray]:
    """What the engine keeps of a keyframe, for the file; `ids` of all rows, its own last."""
    return _renumbered(kept, lambda rows: ids[rows])


def with_rows(kept: Arrays, ids: Int[np.ndarray, " N"]) -> dict[str, np.ndarray]:
    """The same for the engine again; `ids` of all rows that there are, increasing."""

    def row_of(numbers: np.ndarray) -> np.ndarray:
        at = np.searchsorted(ids, numbers)
        return np.where(ids[np.minimum(at, len(ids) - 1)] == numbers, at, GONE)

    return _renumbered(kept, row_of)


def _renumbered(kept: Arrays, new: Callable[[np.ndarray], np.ndarray]) -> dict[str, np.ndarray]:
    found = dict(kept)
    for begin, name, width in TABLES:
        values = kept[name].copy()
        columns = (values[:, None] if values.ndim == 1 else values)[:, :width]
        columns[...] = new(columns)
        there = (columns != GONE).all(1)
        found |= {
            key: (values if key == name else array)[there] for key, array in kept.items() if key.startswith(begin)
        }
    first = kept["first"].copy()
    if first[0] != GONE:
        first[0] = new(first[:1].astype(np.int64))[0]
    found["first"] = first if first[0] != GONE else np.array([GONE, 0, np.inf])
    return found
