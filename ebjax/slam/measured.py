"""Candidates for loop closures as they were measured."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int


@dataclasses.dataclass(frozen=True)
class Measured:
    """Measured candidates, one a row: i > j, direction, distance of the descriptors, matches, motion."""

    i: Int[np.ndarray, " K"]
    j: Int[np.ndarray, " K"]
    opposing: Bool[np.ndarray, " K"]
    distance: Float[np.ndarray, " K"]
    inliers: Int[np.ndarray, " K"]
    total: Int[np.ndarray, " K"]
    i_from_j: Float[np.ndarray, "K 3"]
    covariance: Float[np.ndarray, "K 3 3"]

    def rows(self, which: np.ndarray) -> "Measured":
        """Some of them."""
        return Measured(*(getattr(self, field.name)[which] for field in dataclasses.fields(self)))

    @property
    def quality(self) -> Float[np.ndarray, " K"]:
        """Of two that say the same the one with the larger is the better: its agreeing matches times their share."""
        return self.inliers**2 / np.maximum(self.total, 1)
