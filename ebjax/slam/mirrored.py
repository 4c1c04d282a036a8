"""Whether floor views show the floor, or the room that a polished floor mirrors.

What lies on the floor moves through the view as the robot drives; what is mirrored stays with the robot, or nearly.
"""

from collections.abc import Callable

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from ebjax.geometry.planar import between, matrix
from ebjax.slam.run import Run
from ebjax.views.run_view import RunView

Look = Callable[[int], tuple[UInt8[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]]
STEPS = 40
"""So many are looked at, spread over the run."""
NEAR_PX, ROUND_PX = 10.0, 2.0
"""Views are compared by how they differ from their surroundings, blurred so that a step may be off by a little."""
NOISE = 5.0
"""Grey levels: contrast below is noise, and stays small."""
ALIKE, SHARE = 0.35, 0.5
"""Views as they stand agree at least so well where they mirror a room, and by this share of how well they do where the
floor has moved to; a wrong mount makes both agree badly."""
LEAST_PX, MOST = 5.0, 0.4
"""A step moves the view by so many pixels at least, and by this share of its shorter side at most."""
SAID = (
    "the floor mirrors the room: views agree as they stand ({with_robot:.2f}), not only where the floor has moved to "
    "({on_floor:.2f}); a camera that looks down more steeply, or a polarising filter, sees less of it"
)


def agreement(
    views: tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]],
    floors: tuple[Bool[np.ndarray, "h w"], Bool[np.ndarray, "h w"]],
    second_from_first: Float[np.ndarray, "3 3"],
) -> tuple[float, float] | None:
    """The correlation of two views where the floor has moved to, and of the two as they stand.

    Args:
      views: the second is later.
      floors: what of them is floor.
      second_from_first: a floor point of the first view (px) in the second.

    Returns:
      None where hardly any floor is in both.
    """
    height, width = floors[0].shape
    first, second = (
        cv2.GaussianBlur(detail(view, floor), (0, 0), ROUND_PX) for view, floor in zip(views, floors, strict=True)
    )
    moved = cv2.warpPerspective(first, second_from_first, (width, height))
    there = cv2.warpPerspective(floors[0].astype(np.float32), second_from_first, (width, height)) > 0.99
    both = there & floors[0] & floors[1]
    if both.sum() < 0.1 * both.size:
        return None
    return _correlation(moved[both], second[both]), _correlation(first[both], second[both])


def mirroring(view: RunView, poses: Float[np.ndarray, "N 3"], look: Look) -> tuple[float, float] | None:
    """Medians of `agreement` over a run's steps; None where too few steps can tell.

    Args:
      view: of all of them.
      poses: x, y (m) and heading (rad) of every view.
      look: its number -> the view, and what of it is floor.
    """
    floor_from_view = np.asarray(view.floor_from_view, np.float64)
    (height, width), found = view.size, []
    for k in np.unique(np.linspace(0, max(len(poses) - 2, 0), STEPS).round().astype(int)).tolist()[: len(poses) - 1]:
        step = np.linalg.inv(floor_from_view) @ matrix(between(poses[k + 1], poses[k])) @ floor_from_view
        middle = np.array([(width - 1) / 2, (height - 1) / 2, 1.0])
        there = step @ middle
        if LEAST_PX <= np.linalg.norm(there[:2] / there[2] - middle[:2]) <= MOST * min(view.size):
            (first, its_floor), (second, other_floor) = look(k), look(k + 1)
            pair = agreement((first, second), (its_floor, other_floor), step)
            found += [pair] if pair is not None else []
    if len(found) < 5:
        return None
    on_floor, with_robot = np.median(found, 0).tolist()
    return on_floor, with_robot


def says(run: Run) -> str | None:
    """A sentence where the views stay with the robot, not only with the floor; None where they do not."""
    return told(mirroring(run.view, run.poses[run.keyframes], lambda k: (run.seen(k), run.floor(k))))


def told(found: tuple[float, float] | None) -> str | None:
    """The sentence for what `mirroring` found."""
    if found is None or found[1] <= max(SHARE * found[0], ALIKE):
        return None
    return SAID.format(on_floor=found[0], with_robot=found[1])


def detail(view: UInt8[np.ndarray, "h w 3"], floor: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """How much a view's pixels stand out from their surroundings, in standard deviations of these."""
    grey, seen = cv2.cvtColor(view, cv2.COLOR_RGB2GRAY).astype(np.float32), floor.astype(np.float32)

    def around(values: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
        return cv2.GaussianBlur(values, (0, 0), NEAR_PX)

    weight = np.maximum(around(seen), 1e-3)
    apart = (grey - around(grey * seen) / weight) * seen
    return np.clip(apart / np.sqrt(around(apart**2) / weight + NOISE**2), -4, 4)


def _correlation(a: Float[np.ndarray, "N"], b: Float[np.ndarray, "N"]) -> float:
    a, b = a - a.mean(), b - b.mean()
    return float((a * b).sum() / np.sqrt(max((a**2).sum() * (b**2).sum(), 1e-12)))
