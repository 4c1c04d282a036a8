"""Which inputs of one pair of images contradict each other about the floor.

Two corridors that look alike agree on a motion too: doors, skirting and the joints of tiles lie where the other image
has others of their kind. What tells is the floor. So where a floor view is believed, what puts that floor elsewhere is
not; of two floor views the one that more matches agree on stands.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from ebjax.features.pair import Comparison, PlaneView
from ebjax.features.record import FLOOR, RAW
from ebjax.geometry.camera import ideal_from_raw, raw_from_ideal
from ebjax.geometry.homography import apply

APART = 0.1
"""Motions contradict each other that put the floor so far apart, as a share of the view's side: far more than what a
bent lens leaves to a homography of raw images, far less than a turn by pi moves."""


def contradictions(found: Mapping[str, Comparison], views: Mapping[str, PlaneView]) -> dict[str, str]:
    """Which believed inputs contradict which floor view.

    Args:
      found: of one extractor, by input: RAW, FLOOR, TURNED.
      views: RAW and FLOOR.

    Returns:
      input -> the input that it contradicts; those that do not are left out.
    """
    on_floor = {kind: one for kind, one in found.items() if kind != RAW and one.believed}
    if not on_floor:
        return {}
    told, view = max(on_floor, key=lambda kind: on_floor[kind].inliers), views[FLOOR]
    others = {kind: one for kind, one in found.items() if kind != told and one.believed}
    return {kind: told for kind, one in others.items() if not _agree(found[told], one, view, raw=kind == RAW)}


def _agree(told: Comparison, other: Comparison, view: PlaneView, *, raw: bool) -> bool:
    """Whether the matched floor of a lies at the same places of b by both motions."""
    matched = told.matched
    in_a = np.asarray(told.plane[0], np.float64)[np.asarray(matched.query)[np.asarray(matched.inliers)]]
    moved = _by_raw(other, in_a, view) if raw else _moved(other, in_a)
    apart = np.linalg.norm(moved - _moved(told, in_a), axis=1) / view.side
    return bool(np.median(np.nan_to_num(apart, nan=np.inf)) <= APART)


def _moved(comparison: Comparison, in_a: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N 2"]:
    """From the plane of a to that of b."""
    return np.asarray(apply(np.linalg.inv(comparison.a_from_b), in_a))


def _by_raw(comparison: Comparison, in_a: Float[np.ndarray, "N 2"], view: PlaneView) -> Float[np.ndarray, "N 2"]:
    """Points of the floor view's plane, moved as the raw images are."""
    image_from_plane = view.image_from_view @ np.linalg.inv(view.plane_from_view)
    pixels = np.asarray(apply(image_from_plane, in_a))
    if view.camera is None:
        there = _moved(comparison, pixels)
    else:
        raw = np.asarray(raw_from_ideal(view.camera, pixels))
        there = np.asarray(ideal_from_raw(view.camera, _moved(comparison, raw)))
    return np.asarray(apply(np.linalg.inv(image_from_plane), there))
