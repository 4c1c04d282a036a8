"""What was measured when a keyframe came, as arrays beside its picture: enough to go on from there to the same bits."""

from typing import Any

import numpy as np

from ebjax.features.measure import LoopMeasurement
from ebjax.features.verify_pairs import Settled
from ebjax.odometry.steps import Steps
from ebjax.slam.packed import Arrays

Pair = tuple[int, int, bool]
Told = tuple[int, int, Settled]
"""Agreeing matches, putative ones, and the motion that they settle on."""


def packed_pairs(row: int, pairs: dict[Pair, Told]) -> dict[str, np.ndarray]:
    """The pairs whose later keyframe is `row`."""
    mine = [(j, opposing, *told) for (i, j, opposing), told in pairs.items() if i == row]

    def column(pick: Any, dtype: Any = float) -> np.ndarray:
        return np.array([pick(one) for one in mine], dtype)

    kept = {
        "pairs.j": column(lambda one: one[0], np.int64),
        "pairs.opposing": column(lambda one: one[1], bool),
        "pairs.counts": column(lambda one: one[2:4], np.int64).reshape(-1, 2),
        "pairs.with_depth": column(lambda one: one[4].with_depth, np.int64),
    }
    for name in ("floor", "depth"):
        kept[f"pairs.{name}"] = column(
            lambda one, name=name: np.concatenate([
                np.ravel(getattr(getattr(one[4], name), part)) for part in ("i_from_j", "covariance", "residual_m")
            ])
        ).reshape(-1, 13)  # fmt: skip
    return kept


def unpacked_pairs(row: int, kept: Arrays) -> dict[Pair, Told]:
    """The same again."""
    found: dict[Pair, Told] = {}
    for k in range(len(kept["pairs.j"])):
        floor, depth = (
            LoopMeasurement(values[:3], values[3:12].reshape(3, 3), values[12])
            for values in (kept["pairs.floor"][k], kept["pairs.depth"][k])
        )
        end = row, int(kept["pairs.j"][k]), bool(kept["pairs.opposing"][k])
        inliers, total = kept["pairs.counts"][k].tolist()
        found[end] = inliers, total, Settled(floor, depth, kept["pairs.with_depth"][k])
    return found


def packed_steps(steps: Steps) -> dict[str, np.ndarray]:
    """A table of steps."""
    return {
        "steps.ends": np.stack([steps.i, steps.j], 1).astype(np.int64),
        "steps.counts": np.stack([steps.inliers, steps.matches], 1).astype(np.int64),
        "steps.i_from_j": np.asarray(steps.i_from_j, float),
        "steps.covariance": np.asarray(steps.covariance, float),
        "steps.words": np.array(
            [f"{kind}\n{reason}" for kind, reason in zip(steps.kind, steps.reason, strict=True)], "S"
        ),
    }


def unpacked_steps(kept: Arrays) -> Steps:
    """The same again."""
    words = [bytes(word).decode().split("\n") for word in kept["steps.words"]]
    kind, reason = (np.array([word[k] for word in words], object) for k in (0, 1))
    (i, j), (inliers, matches) = kept["steps.ends"].T, kept["steps.counts"].T
    return Steps(i, j, kind, inliers, matches, kept["steps.i_from_j"], kept["steps.covariance"], reason)
