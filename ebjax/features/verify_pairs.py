"""Verification of many pairs of described frames, a block a call: one program for all of a process."""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int

from ebjax.features.landmarks import Landmarks
from ebjax.features.measure import LoopMeasurement, measure_depth, measure_floor
from ebjax.features.settle import PairMatches, depth_motion, floor_motion, pair_matches
from ebjax.features.verify import Verified, verify
from ebjax.geometry.camera import Camera
from ebjax.views.run_view import RunView

PAIRS_A_CALL = 64
Found = tuple[Verified, LoopMeasurement, LoopMeasurement, Int[np.ndarray, " K"], PairMatches]


@partial(jax.jit, static_argnames="tolerance_m")
def _block(query: Landmarks, reference: Landmarks, keys, view: RunView, camera: Camera, tolerance_m: float):
    def one(args):
        ours, theirs, key = args
        found = verify(
            ours.features, theirs.features, ours.floor_points, theirs.floor_points, key=key, tolerance=tolerance_m
        )
        q, r = found.query, found.reference
        floor = measure_floor(ours.floor_points[q], theirs.floor_points[r], found.inliers)
        deep = found.inliers & (ours.range_m[q] > 0) & (theirs.range_m[r] > 0)
        range_m = jnp.maximum(ours.range_m[q], theirs.range_m[r])
        depth = measure_depth(ours.points[q], theirs.points[r], deep, range_m)
        return found, floor, depth, deep.sum(), pair_matches(ours, theirs, found, view, camera)

    return jax.lax.map(one, (query, reference, keys))


def verify_blocks(
    pick: Callable[..., tuple[Landmarks, Landmarks]],
    view: RunView,
    camera: Camera,
    i: Int[np.ndarray, " K"],
    j: Int[np.ndarray, " K"],
    opposing: Bool[np.ndarray, " K"],
    *,
    tolerance_m: float,
    seed: int,
) -> Found:
    """Verifies and measures pairs: RANSAC's matches; i_from_j by the floor and by depth; how many inliers have depth.

    Args:
      pick: (rows of i, rows of j, opposing) -> the landmarks of both, the second as the first's direction has them.
      view: of the run.
      camera: of the run.
      i: rows of the later frames.
      j: rows of the earlier frames.
      opposing: whether a pair looks at the floor from opposite sides.
      tolerance_m: largest distance of matching points on the floor.
      seed: of RANSAC.
    """
    keys = jax.random.split(jax.random.key(seed), max(len(i), 1))
    results = []
    for start in range(0, max(len(i), 1), PAIRS_A_CALL):
        rows = np.arange(start, start + PAIRS_A_CALL) % max(len(i), 1)  # the last block is filled up: one shape
        a, b = (i[rows], j[rows]) if len(i) else (np.zeros(PAIRS_A_CALL, int),) * 2
        facing = opposing[rows] if len(i) else np.zeros(PAIRS_A_CALL, bool)
        query, reference = pick(a, b, facing)
        results.append(jax.tree.map(np.asarray, _block(query, reference, keys[rows], view, camera, tolerance_m)))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[: len(i)], *results)


@jax.jit
def _settle(matches: PairMatches, camera: Camera, tolerance_m):
    def one(pair):
        deep, with_depth = depth_motion(pair, camera, tolerance_m)
        return floor_motion(pair, camera, tolerance_m), deep, with_depth.sum()

    return jax.lax.map(one, matches)


def settle_blocks(
    matches: PairMatches, camera: Camera, tolerance_m: float
) -> tuple[LoopMeasurement, LoopMeasurement, Int[np.ndarray, " K"]]:
    """Every pair's motion by the floor and by depth under a camera's mount, and how many matches have depth."""
    count = len(matches.start)
    results = []
    for start in range(0, max(count, 1), PAIRS_A_CALL):
        rows = np.arange(start, start + PAIRS_A_CALL) % max(count, 1)
        if not count:
            matches = jax.tree.map(lambda leaf: np.zeros((1, *leaf.shape[1:]), leaf.dtype), matches)
        block = jax.tree.map(lambda leaf, rows=rows: leaf[rows], matches)
        results.append(jax.tree.map(np.asarray, _settle(block, camera, tolerance_m)))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:count], *results)
