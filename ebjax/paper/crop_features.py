"""Local features on crops of floors: each crop with the same floor turned by pi, from elsewhere and in other light."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from ebjax.command import progress
from ebjax.features.extractor import Extractor
from ebjax.features.pair import compare, extract, raw_view
from ebjax.features.record import image_b_from_a
from ebjax.geometry.homography import apply
from ebjax.paper.crops import SIDE_PX

RIGHT = 3 / 400
"""Mean error of a right motion, as a share of the view's side: as in table 3."""
TOLERANCE = 0.01
GRID = 21


@dataclasses.dataclass(frozen=True)
class CropPair:
    """A crop, what is seen of it again, turned by pi, and where its pixels lie there."""

    crop: UInt8[np.ndarray, "S S 3"]
    query: UInt8[np.ndarray, "S S 3"]
    query_from_crop: Float[np.ndarray, "3 3"]


def measure(chosen: Extractor, pairs: Sequence[CropPair], *, seed: int) -> dict[str, Any]:
    """Mean inliers and matches, pairs whose motion is right, pairs."""
    view, found = raw_view(SIDE_PX, SIDE_PX), []
    for pair in progress(pairs, len(pairs), "matching crops"):
        a, b = extract(chosen, pair.crop, view), extract(chosen, pair.query, view, turned=True)
        both = compare(a, b, view, model="homography", tolerance=TOLERANCE, seed=seed)
        error = error_px(image_b_from_a(both, view), pair.query_from_crop) if both.inliers else math.inf
        found.append((both.inliers, both.total, error < RIGHT * SIDE_PX))
    inliers, total, right = (np.array(column) for column in zip(*found, strict=True))
    return {
        "inliers": float(inliers.mean()),
        "total": float(total.mean()),
        "right": int(right.sum()),
        "pairs": len(pairs),
    }


def error_px(found: Float[np.ndarray, "3 3"], true: Float[np.ndarray, "3 3"]) -> float:
    """How far a motion puts the crop's pixels, of those that the query shows, from where they are, on average."""
    steps = np.linspace(0, SIDE_PX - 1, GRID)
    points = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    ours, theirs = (np.asarray(apply(motion, points)) for motion in (found, true))
    shown = ((theirs >= 0) & (theirs <= SIDE_PX - 1)).all(1)
    error = float(np.linalg.norm(ours - theirs, axis=1)[shown].mean())
    return error if math.isfinite(error) else math.inf
