"""RANSAC for planar motions: all hypotheses at once, fixed shapes, MSAC score, refined on the inliers.

Jitted; vmap it over pairs (one key each). Points in any unit; the tolerance is in the target's.
"""

import typing
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, UInt32

from ebjax.geometry.homography import Arrays, Scalar, denominator, from_four_points, orient
from ebjax.geometry.homography import fit as fit_homography
from ebjax.geometry.pytree import pytree
from ebjax.geometry.rigid import fit_rigid, fit_similarity

Key = PRNGKeyArray | UInt32[Array, "2"]
Model = typing.Literal["rigid", "similarity", "homography"]
FITS = {"rigid": fit_rigid, "similarity": fit_similarity, "homography": fit_homography}
ROUNDS = 3


@pytree
class RansacResult:
    """target = homography(source), w > 0 at the inliers; which they are; how many. Nothing found: identity and 0."""

    homography: Float[Array, "3 3"]
    inliers: Bool[Array, " N"]
    count: Int[Array, ""]


def draw_sets(valid: Bool[Array, " N"], key: Key, sets: int, size: int) -> Int[Array, "sets size"]:
    """Draws index sets without replacement among the valid points; with fewer than `size` of them, of no use."""
    before = jnp.cumsum(valid.astype(jnp.int32))
    count = before[-1]
    uniform = jax.random.uniform(key, (sets, size), jnp.float32)
    picks: list[Array] = []
    for k in range(size):
        pick = jnp.minimum((uniform[:, k] * (count - k)).astype(jnp.int32), count - k - 1)
        if picks:
            taken = jnp.sort(jnp.stack(picks), axis=0)
            for earlier in taken:
                pick = pick + (pick >= earlier)
        picks.append(pick)
    ranks = jnp.stack(picks, axis=1)
    return jnp.clip(jnp.searchsorted(before, ranks + 1), 0, valid.shape[0] - 1).astype(jnp.int32)


def _squared_residuals(
    h: Float[Array, "3 3"], source: Float[Array, "N 2"], target: Float[Array, "N 2"], model: str
) -> Float[Array, " N"]:
    """|H p - q|^2; huge on the far side of the horizon, w <= 0."""
    sx, sy = source[:, 0], source[:, 1]
    x, y = h[0, 0] * sx + h[0, 1] * sy + h[0, 2], h[1, 0] * sx + h[1, 1] * sy + h[1, 2]
    if model != "homography":
        return (x - target[:, 0]) ** 2 + (y - target[:, 1]) ** 2
    w = jnp.maximum(h[2, 0] * sx + h[2, 1] * sy + h[2, 2], 1e-12)
    return (x / w - target[:, 0]) ** 2 + (y / w - target[:, 1]) ** 2


def _minimal(
    source: Float[Array, "k 2"], target: Float[Array, "k 2"], model: str
) -> tuple[Float[Array, "3 3"], Bool[Array, ""]]:
    """A hypothesis from a minimal set, w > 0 there, and whether it can be real."""
    if model != "homography":
        h = FITS[model](source, target, jnp.ones(source.shape[0], source.dtype))
        return h, jnp.all(jnp.isfinite(h))
    h = orient(from_four_points(source, target), source[0])
    return h, jnp.all(jnp.isfinite(h)) & jnp.all(denominator(h, source) > 0)


@partial(jax.jit, static_argnames=("model", "hypotheses"))
def estimate(
    source: Float[Arrays, "N 2"],
    target: Float[Arrays, "N 2"],
    valid: Bool[Arrays, " N"],
    *,
    key: Key,
    model: Model = "rigid",
    hypotheses: int = 512,
    tolerance: Scalar,
) -> RansacResult:
    """Minimises sum min(|H source - target|^2, tolerance^2) over H (MSAC, Torr and Zisserman 2000) by random sets.

    The best hypothesis is refitted three times with weights (1 - r^2 / tolerance^2)^2; the best of all is returned.

    Args:
      source: points.
      target: their putative partners.
      valid: which rows count; the others may hold anything.
      key: for drawing the minimal sets.
      model: rigid (2 points, no reflection), similarity (2) or homography (4; points on the far side of its horizon
        are outliers, and minimal sets that straddle it are rejected).
      hypotheses: how many minimal sets.
      tolerance: largest residual of an inlier, in the target's unit.
    """
    valid = jnp.asarray(valid)
    source = jnp.where(valid[:, None], jnp.asarray(source), 0)
    target = jnp.where(valid[:, None], jnp.asarray(target), 0)
    dtype, size = source.dtype, 4 if model == "homography" else 2
    limit = jnp.asarray(tolerance, dtype) ** 2

    far = jnp.where(valid[:, None], target, 1e15)

    def cost(h):
        return jnp.sum(jnp.minimum(_squared_residuals(h, source, far, model), limit))

    sets = draw_sets(valid, key, hypotheses, size)
    hs, possible = jax.vmap(partial(_minimal, model=model))(source[sets], target[sets])
    costs = jax.vmap(cost)(hs)
    costs = jnp.where(possible & jnp.isfinite(costs), costs, jnp.inf)
    first = jnp.argmin(costs)
    found = jnp.isfinite(costs[first]) & (valid.sum() >= size)

    def refit(_, state):
        h, best, best_cost = state
        squared = _squared_residuals(h, source, far, model)
        weights = jnp.where(squared <= limit, (1 - squared / limit) ** 2, 0)
        if model == "homography":
            # The algebraic residual is the geometric one times w.
            weights = weights / jnp.where(weights > 0, denominator(h, source), 1) ** 2
        h = orient(FITS[model](source, target, weights), source[sets[first, 0]])
        new_cost = cost(h)
        better = new_cost < best_cost
        return jnp.where(better, h, hs[first]), jnp.where(better, h, best), jnp.where(better, new_cost, best_cost)

    _, best, _ = jax.lax.fori_loop(0, ROUNDS, refit, (hs[first], hs[first], costs[first]))
    inliers = valid & (_squared_residuals(best, source, far, model) <= limit)
    count = inliers.sum(dtype=jnp.int32)
    found &= count >= size
    identity = jnp.eye(3, dtype=dtype)
    return RansacResult(jnp.where(found, best, identity), inliers & found, jnp.where(found, count, 0))
