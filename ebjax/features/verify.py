"""Verification of a loop candidate: matches on the floor, RANSAC, and the pose of one robot in the other's frame.

Everything happens in floor coordinates: with a metric view a rigid motion in metres, i_from_j, is found directly,
whatever the direction; without one, the homography between the two views. One pair is a pure function of two feature
sets; vmap or `lax.map` it.
"""

import math
from functools import partial

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, UInt32

from ebjax.features.matching import Features, mutual_nearest
from ebjax.geometry.homography import Scalar
from ebjax.geometry.pytree import pytree
from ebjax.geometry.ransac import Model, estimate

HYPOTHESES = {"rigid": 512, "similarity": 512, "homography": 4096}
"""Random sets: four good matches of a homography's set at once are rare."""


@pytree
class Verified:
    """What two views have in common: point rows that match, which of them agree, and the motion they agree on."""

    query: Int[Array, "*n M"]
    reference: Int[Array, "*n M"]
    matched: Bool[Array, "*n M"]
    inliers: Bool[Array, "*n M"]
    query_from_reference: Float[Array, "*n 3 3"]

    @property
    def count(self) -> Int[Array | np.ndarray | np.integer, "*n"]:
        """Inliers."""
        return self.inliers.sum(-1)

    @property
    def total(self) -> Int[Array | np.ndarray | np.integer, "*n"]:
        """Putative matches."""
        return self.matched.sum(-1)


def log10_false_alarms(inliers: int, total: int, chance: float, model: Model) -> float:
    """log10 of how many motions with so many inliers random matches would show (a contrario, Moisan and Stival 2004).

    NFA = (n - m) C(n, k) C(k, m) p^(k - m) for k inliers of n matches and minimal sets of m. Below 0 is unlikely.

    Args:
      inliers: matches that agree.
      total: putative matches.
      chance: probability that a random match agrees: pi tolerance^2 / area of the view.
      model: of the motion.
    """
    size = 4 if model == "homography" else 2
    if inliers <= size:
        return math.inf

    def log_choose(n: int, k: int) -> float:
        return math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)

    log = math.log(max(total - size, 1)) + log_choose(total, inliers) + log_choose(inliers, size)
    return (log + (inliers - size) * math.log(chance)) / math.log(10)


@partial(jax.jit, static_argnames=("model", "keep"))
def verify(
    query: Features,
    reference: Features,
    query_points: Float[Array, "K 2"],
    reference_points: Float[Array, "K 2"],
    *,
    key: PRNGKeyArray | UInt32[Array, "2"],
    tolerance: Scalar,
    model: Model = "rigid",
    keep: int = 300,
    max_ratio: Scalar = 1.0,
) -> Verified:
    """Matches two views and finds the motion that most matches agree on.

    Args:
      query: features of the later view.
      reference: features of the earlier view, descriptors turned by pi for an opposing candidate.
      query_points: the keypoints in floor coordinates (m in base_i, or view px).
      reference_points: the keypoints in floor coordinates (m in base_j, or view px).
      key: for RANSAC.
      tolerance: largest residual of an inlier, in the unit of the points.
      model: rigid for metric points, similarity or homography otherwise.
      keep: the most distinctive matches that are used.
      max_ratio: Lowe's ratio.
    """
    matches = mutual_nearest(query, reference, keep=keep, max_ratio=max_ratio)
    source, target = reference_points[matches.reference], query_points[matches.query]
    found = estimate(
        source, target, matches.valid, key=key, model=model, hypotheses=HYPOTHESES[model], tolerance=tolerance
    )
    return Verified(matches.query, matches.reference, matches.valid, found.inliers, found.homography)
