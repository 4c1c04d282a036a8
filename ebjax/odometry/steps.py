"""Measured steps between keyframes, as a table, and when one is believed by itself."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int

MIN_INLIERS, MIN_RATIO = 20, 0.4
MAX_SIGMA_M, MAX_SIGMA_DEG = 0.05, 1.0
USED = "used"
SCALE_SIGMA = 7e-5
"""Of a scale that all steps and closures share: blur and compression pull all patches alike. The independent edges of
a graph cannot say it; over many metres straight ahead it is what is left. So large that `evaluation nees` is near 3
over 5 and 20 m on the worlds of configs/worlds."""


@dataclasses.dataclass(frozen=True)
class Steps:
    """Steps, one a row: rows i > j of the keyframes, how measured, matches, motion, covariance, and whether it counts.

    Attributes:
      i: row of the later keyframe.
      j: row of the earlier one.
      kind: "floor", "depth", "image" (the whole image, scale by the floor or depth in it) or "rotation" (its angle).
      inliers: matches that agree.
      matches: putative ones.
      i_from_j: x, y (m) and heading (rad).
      covariance: in the right tangent.
      reason: "used", or why not.
    """

    i: Int[np.ndarray, " K"]
    j: Int[np.ndarray, " K"]
    kind: np.ndarray
    inliers: Int[np.ndarray, " K"]
    matches: Int[np.ndarray, " K"]
    i_from_j: Float[np.ndarray, "K 3"]
    covariance: Float[np.ndarray, "K 3 3"]
    reason: np.ndarray

    @property
    def used(self) -> Bool[np.ndarray, " K"]:
        """Which count."""
        return self.reason == USED

    def rows(self, which: Bool[np.ndarray, " K"]) -> "Steps":
        """Some of them."""
        return Steps(*(getattr(self, field.name)[which] for field in dataclasses.fields(self)))

    def consecutive(self) -> Int[np.ndarray, " n"]:
        """Rows of the used steps from the keyframe before."""
        return np.flatnonzero(self.used & (self.i - self.j == 1))

    def refuse(self, rows: Bool[np.ndarray, " K"], why: str) -> "Steps":
        """The table with some of the used rows refused."""
        return dataclasses.replace(self, reason=np.where(rows & self.used, why, self.reason))

    def share(self) -> Float[np.ndarray, " K"]:
        """How much wider a step counts, so that a view measured against several others is not counted as often.

        A view's own error enters all its steps. Two steps a view, one back and one ahead, are a chain, which counts it
        once; with more of them each counts for less.
        """
        used = self.used
        degree = np.bincount(np.concatenate([self.i[used], self.j[used]]), minlength=1 + int(self.i.max(initial=0)))
        return np.maximum((degree[self.i] + degree[self.j]) / 4, 1.0)


def judged(
    i: Int[np.ndarray, " K"],
    j: Int[np.ndarray, " K"],
    kind: np.ndarray,
    inliers: Int[np.ndarray, " K"],
    matches: Int[np.ndarray, " K"],
    i_from_j: Float[np.ndarray, "K 3"],
    covariance: Float[np.ndarray, "K 3 3"],
) -> Steps:
    """The table, each row judged by its own matches and certainty."""
    sigma = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0))
    reason = np.full(len(i), USED, object)
    reason[(sigma[:, :2].max(1, initial=0) > MAX_SIGMA_M) | (np.degrees(sigma[:, 2]) > MAX_SIGMA_DEG)] = "uncertain"
    reason[inliers < MIN_RATIO * matches] = "few of the matches agree"
    reason[inliers < MIN_INLIERS] = "few matches"
    reason[~np.isfinite(i_from_j).all(1) | ~np.isfinite(sigma).all(1)] = "few matches"
    return Steps(i, j, kind, inliers, matches, i_from_j, covariance, reason)


def no_steps() -> Steps:
    """A table without rows."""
    none, words = np.zeros(0, int), np.zeros(0, object)
    return Steps(none, none, words, none, none, np.zeros((0, 3)), np.zeros((0, 3, 3)), words)


def joined(tables: list[Steps]) -> Steps:
    """Several tables as one, ordered by the later keyframe."""
    columns = [np.concatenate([getattr(t, f.name) for t in tables]) for f in dataclasses.fields(Steps)]
    order = np.lexsort((columns[1], columns[0]))
    return Steps(*(column[order] for column in columns))
