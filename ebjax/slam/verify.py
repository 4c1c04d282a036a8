"""Verification of a run's loop candidates, many pairs of keyframes a call: matches, RANSAC, two measurements each."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int

from ebjax.features.extractor import Extractor
from ebjax.features.landmarks import Landmarks, take
from ebjax.features.measure import LoopMeasurement, measure_depth, measure_floor
from ebjax.features.verify import Verified, verify
from ebjax.slam.describe import Described

PAIRS_A_CALL = 64


def verify_pairs(
    described: Described,
    chosen: Extractor,
    i: Int[np.ndarray, " K"],
    j: Int[np.ndarray, " K"],
    opposing: Bool[np.ndarray, " K"],
    *,
    tolerance_m: float,
    seed: int,
) -> tuple[Verified, LoopMeasurement, LoopMeasurement, Int[np.ndarray, " K"]]:
    """Verifies and measures pairs of keyframes: by the metric floor, by depth, and how many inliers have depth."""

    @jax.jit
    def block(query: Landmarks, reference: Landmarks, keys):
        def one(args):
            ours, theirs, key = args
            found = verify(
                ours.features,
                theirs.features,
                ours.floor_points,
                theirs.floor_points,
                key=key,
                tolerance=tolerance_m,
            )
            q, r = found.query, found.reference
            floor = measure_floor(ours.floor_points[q], theirs.floor_points[r], found.inliers)
            deep = found.inliers & (ours.range_m[q] > 0) & (theirs.range_m[r] > 0)
            range_m = jnp.maximum(ours.range_m[q], theirs.range_m[r])
            depth = measure_depth(ours.points[q], theirs.points[r], deep, range_m)
            return found, floor, depth, deep.sum()

        return jax.lax.map(one, (query, reference, keys))

    keys = jax.random.split(jax.random.key(seed), max(len(i), 1))
    results = []
    for start in range(0, max(len(i), 1), PAIRS_A_CALL):
        rows = np.arange(start, start + PAIRS_A_CALL) % max(len(i), 1)  # the last block is filled up: one shape
        a, b = (i[rows], j[rows]) if len(i) else (np.zeros(PAIRS_A_CALL, int),) * 2
        facing = opposing[rows] if len(i) else np.zeros(PAIRS_A_CALL, bool)
        query, reference = take(described.landmarks, a), seen_from(described, chosen, b, facing)
        results.append(jax.tree.map(np.asarray, block(query, reference, keys[rows])))
    joined = jax.tree.map(lambda *leaves: np.concatenate(leaves)[: len(i)], *results)
    return joined


def seen_from(
    described: Described, chosen: Extractor, rows: Int[np.ndarray, " K"], facing: Bool[np.ndarray, " K"]
) -> Landmarks:
    """The landmarks of keyframes, as a view in the same direction has them or, where `facing`, the opposite one."""
    straight = take(described.landmarks, rows)
    if chosen.turn is None:
        assert described.turned is not None
        turned = take(described.turned, rows)
    else:
        descriptors = chosen.turn(jnp.asarray(straight.features.descriptors))
        turned = dataclasses.replace(straight, features=dataclasses.replace(straight.features, descriptors=descriptors))
    return jax.tree.map(lambda s, t: np.where(facing.reshape(-1, *(1,) * (s.ndim - 1)), t, s), straight, turned)
