"""Verification of two described frames: one program for all pairs of a process, each pair by itself.

A pair's random hypotheses are drawn from its own numbers, so that what it gives never depends on what else is verified,
in which order or how many at a time.
"""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float, Int, UInt32

from ebjax.features.landmarks import Landmarks
from ebjax.features.measure import LoopMeasurement
from ebjax.features.settle import PairMatches, depth_motion, floor_motion, pair_matches
from ebjax.features.verify import Verified, verify
from ebjax.geometry.camera import Camera
from ebjax.geometry.pytree import pytree
from ebjax.views.run_view import RunView

BLOCK = 64
"""Pairs whose matches are asked for at once."""


@pytree
class Settled:
    """A pair's motion by the floor and by depth under a camera's mount, and how many matches have depth."""

    floor: LoopMeasurement
    depth: LoopMeasurement
    with_depth: Int[Array, "*n"]


@pytree
class VerifiedPair:
    """RANSAC's matches of a pair, what is known of each of them, and the motion they settle on."""

    verified: Verified
    matches: PairMatches
    settled: Settled


def settled_motion(matches: PairMatches, camera: Camera, tolerance_m: float | Float[Array, ""]) -> Settled:
    """One pair's motion."""
    deep, with_depth = depth_motion(matches, camera, tolerance_m)
    return Settled(floor_motion(matches, camera, tolerance_m), deep, with_depth.sum())


@partial(jax.jit, static_argnames="tolerance_m")
def verify_pair(
    ours: Landmarks,
    theirs: Landmarks,
    numbers: UInt32[Array, "4"],
    view: RunView,
    camera: Camera,
    tolerance_m: float,
) -> VerifiedPair:
    """Verifies and measures one pair.

    Args:
      ours: of the later frame.
      theirs: of the earlier one, as the later one's direction has them.
      numbers: seed, number of the later frame, of the earlier one, whether they face each other.
      view: of the run.
      camera: of the run.
      tolerance_m: largest distance of matching points on the floor, m.
    """
    key = jax.random.key(numbers[0])
    for number in numbers[1:]:
        key = jax.random.fold_in(key, number)
    found = verify(
        ours.features, theirs.features, ours.floor_points, theirs.floor_points, key=key, tolerance=tolerance_m
    )
    matches = pair_matches(ours, theirs, found, view, camera)
    return VerifiedPair(found, matches, settled_motion(matches, camera, tolerance_m))


def pair_numbers(seed: int, i: int, j: int, opposing: bool) -> UInt32[np.ndarray, "4"]:
    """What the random hypotheses of a pair are drawn from."""
    return np.array([seed, i, j, opposing], np.uint32)


_settle = jax.jit(settled_motion)


def rows_of(matches: PairMatches) -> Callable[[Int[np.ndarray, " n"]], PairMatches]:
    """What gives some rows of matches that are all at hand."""
    return lambda rows: jax.tree.map(lambda leaf: np.asarray(leaf)[rows], matches)


def settle_all(
    matches: Callable[[Int[np.ndarray, " n"]], PairMatches], count: int, camera: Camera, tolerance_m: float
) -> Settled:
    """Every pair's motion under another mount of the camera.

    Args:
      matches: of some rows.
      count: of pairs.
      camera: as it is mounted.
      tolerance_m: matches that are farther off count for nothing.
    """
    found = []
    for start in range(0, count, BLOCK):
        some = matches(np.arange(start, min(start + BLOCK, count)))
        for k in range(len(some.start)):
            one = jax.tree.map(lambda leaf, k=k: leaf[k], some)
            found.append(jax.tree.map(np.asarray, _settle(one, camera, tolerance_m)))
    return stacked(found)


def stacked(rows: Iterable[Settled]) -> Settled:
    """Many pairs' motions as arrays."""
    found = list(rows)
    if not found:
        empty: Any = (np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0), np.zeros(0, int))
        none = LoopMeasurement(*empty[:3])
        return Settled(none, none, empty[3])
    return jax.tree.map(lambda *leaves: np.stack(leaves), *found)
