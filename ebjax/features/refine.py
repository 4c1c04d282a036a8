"""Guided re-matching: once the motion is roughly known, each keypoint looks for its partner only where it should be.

Repeated texture (grout, planks) makes most putative matches ambiguous; near the predicted place they are not, and
there are enough of them all over the overlap to hold a homography where RANSAC's few inliers leave it free. The
search narrows from four tolerances to one, so the first motion may be a few tolerances off; and then once more, as what
the first round found far from RANSAC's inliers was looked for where those put it.

The number of these matches says nothing about whether the motion is right: they were looked for where it wants them.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ebjax.features.matching import Features
from ebjax.features.verify import Verified
from ebjax.geometry.homography import apply, denominator
from ebjax.geometry.ransac import FITS, Model

SCALES = (4.0, 3.0, 2.0, 1.5, 1.0, 1.0) * 2
REACH = 1.5
MIN_SIMILARITY = 0.6
ROUNDS = 3


def _squared(h: Float[Array, "3 3"], source: Float[Array, "K 2"], target: Float[Array, "K 2"]) -> Float[Array, " K"]:
    return jnp.sum((apply(h, source) - target) ** 2, axis=1)


def _partners(
    similarity: Float[Array, "Q R"],
    predicted: Float[Array, "R 2"],
    query_points: Float[Array, "Q 2"],
    radius: Float[Array, ""],
) -> tuple[Int[Array, " Q"], Bool[Array, " Q"]]:
    """Mutual nearest neighbours among the pairs closer than the radius."""
    dx = query_points[:, 0, None] - predicted[None, :, 0]
    dy = query_points[:, 1, None] - predicted[None, :, 1]
    near = jnp.where(dx**2 + dy**2 < radius**2, similarity, -2)
    nearest, back = jnp.argmax(near, axis=1).astype(jnp.int32), jnp.argmax(near, axis=0)
    return nearest, (back[nearest] == jnp.arange(len(nearest))) & (jnp.max(near, axis=1) > -2)


@partial(jax.jit, static_argnames="model")
def refine(
    query: Features,
    reference: Features,
    query_points: Float[Array, "Q 2"],
    reference_points: Float[Array, "R 2"],
    start: Float[Array, "3 3"],
    *,
    tolerance: float | Float[Array, ""],
    model: Model,
) -> Verified:
    """Matches again around a first motion and fits it to the result, weights (1 - r^2 / s^2)^2, s narrowing.

    Args:
      query: features of one view.
      reference: features of the other, descriptors turned by pi for an opposing pair.
      query_points: the keypoints in floor coordinates.
      reference_points: likewise.
      start: query_from_reference, within about four tolerances where the views overlap.
      tolerance: largest residual of an inlier, in the unit of the points.
      model: of the motion.

    Returns:
      One row a query keypoint: `matched` are the guided matches, `inliers` those within the tolerance.
    """
    similarity = query.descriptors @ reference.descriptors.T
    allowed = query.valid[:, None] & reference.valid[None, :] & (similarity > MIN_SIMILARITY)
    similarity = jnp.where(allowed, similarity, -2)
    limit = jnp.asarray(tolerance, query_points.dtype)

    def step(state, scale):
        h = state
        nearest, found = _partners(similarity, apply(h, reference_points), query_points, REACH * scale * limit)
        source = jnp.where(found[:, None], reference_points[nearest], 0)
        for _ in range(ROUNDS):
            share = 1 - _squared(h, source, query_points) / (scale * limit) ** 2
            weights = jnp.where(found & (share > 0), share**2, 0).astype(source.dtype)
            if model == "homography":
                # The algebraic residual is the geometric one times w.
                weights = weights / jnp.where(weights > 0, denominator(h, source), 1) ** 2
            h = FITS[model](source, query_points, weights)
        return h, (nearest, found, _squared(h, source, query_points))

    h, (nearest, found, squared) = jax.lax.scan(step, start, jnp.asarray(SCALES, query_points.dtype))
    rows = jnp.arange(query_points.shape[0], dtype=jnp.int32)
    return Verified(rows, nearest[-1], found[-1], found[-1] & (squared[-1] <= limit**2), h)
