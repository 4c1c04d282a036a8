"""What was measured when a keyframe came, as arrays beside its picture: enough to go on from there to the same bits."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ebjax.features.measure import LoopMeasurement
from ebjax.features.verify_pairs import Settled, VerifiedPair
from ebjax.odometry.steps import Steps
from ebjax.slam.packed import Arrays

Ends = tuple[int, bool]
"""Of a pair, beside its later keyframe: the earlier one, and whether they face each other."""
PARTS = ("i_from_j", "covariance", "residual_m")


class Told(NamedTuple):
    """What verifying a pair gave: agreeing matches, putative ones, those with depth, the motion by floor and by depth.

    Each motion is a row: `i_from_j`, `covariance`, `residual_m`.
    """

    inliers: int
    total: int
    with_depth: int
    motions: Float[np.ndarray, "2 13"]

    @classmethod
    def of(cls, found: VerifiedPair) -> "Told":
        """Of a pair that was verified."""
        settled = found.settled
        rows = [[np.ravel(getattr(way, part)) for part in PARTS] for way in (settled.floor, settled.depth)]
        motions = np.array([np.concatenate(row) for row in rows], float)
        return cls(int(found.verified.count), int(found.verified.total), int(settled.with_depth), motions)

    @property
    def settled(self) -> Settled:
        """The motions again."""
        floor, depth = (LoopMeasurement(row[:3], row[3:12].reshape(3, 3), row[12]) for row in self.motions)
        return Settled(floor, depth, np.asarray(self.with_depth))  # type: ignore[arg-type]


def packed_pairs(pairs: dict[Ends, Told]) -> dict[str, np.ndarray]:
    """Of a keyframe the pairs of which it is the later one."""
    ends, told = list(pairs), list(pairs.values())
    motions = np.array([one.motions for one in told], float).reshape(-1, 2, 13)
    return {
        "pairs.j": np.array([j for j, _ in ends], np.int64),
        "pairs.opposing": np.array([opposing for _, opposing in ends], bool),
        "pairs.counts": np.array([one[:2] for one in told], np.int64).reshape(-1, 2),
        "pairs.with_depth": np.array([one.with_depth for one in told], np.int64),
        "pairs.floor": motions[:, 0].copy(),
        "pairs.depth": motions[:, 1].copy(),
    }


def unpacked_pairs(kept: Arrays) -> dict[Ends, Told]:
    """The same again."""
    ends = zip(kept["pairs.j"].tolist(), kept["pairs.opposing"].tolist(), strict=True)
    # Copies: an array of a map's file holds on to all that is kept of its keyframe.
    motions = np.stack([kept["pairs.floor"], kept["pairs.depth"]], 1)
    counts = zip(kept["pairs.counts"].tolist(), kept["pairs.with_depth"].tolist(), motions, strict=True)
    told = [Told(inliers, total, deep, both.copy()) for (inliers, total), deep, both in counts]
    return dict(zip(ends, told, strict=True))


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
