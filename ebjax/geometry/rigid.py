"""Rigid and similar motions between matched points, target = s R source + t, no reflections; ICP for unmatched ones.

Weighted, differentiable once in points and weights, and free of NaN: without two distinct points R is the identity.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ebjax.geometry.homography import Arrays, Scalar


def _centred(
    source: Float[Array, "N D"], target: Float[Array, "N D"], weights: Float[Array, " N"]
) -> tuple[Float[Array, "N D"], Float[Array, "N D"], Float[Array, " D"], Float[Array, " D"], Float[Array, " N"]]:
    share = weights / (jnp.sum(weights) + jnp.finfo(weights.dtype).tiny ** 0.5)
    source_mean, target_mean = share @ source, share @ target
    return source - source_mean[None, :], target - target_mean[None, :], source_mean, target_mean, share


def _dot_cross(
    p: Float[Array, "N 2"], q: Float[Array, "N 2"], weights: Float[Array, " N"]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Weighted sums of p . q and p x q: the complex number sum w conj(p) q."""
    return jnp.sum(weights * (p * q).sum(axis=1)), jnp.sum(weights * (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]))


def _rotation_2d(dot: Float[Array, ""], cross: Float[Array, ""]) -> Float[Array, "2 2"]:
    tiny = jnp.finfo(dot.dtype).tiny ** 0.5
    some = dot**2 + cross**2 > tiny
    norm = jnp.sqrt(jnp.where(some, dot**2 + cross**2, jnp.ones_like(dot)))
    c, s = jnp.where(some, dot / norm, jnp.ones_like(dot)), jnp.where(some, cross / norm, jnp.zeros_like(dot))
    return jnp.stack([jnp.stack([c, -s]), jnp.stack([s, c])])


def _top_eigenvector(matrix: Float[Array, "4 4"]) -> Float[Array, "4"]:
    """Eigenvector v of the largest eigenvalue l; its first derivative is sum_i v_i (v_i^T dM v) / (l - l_i).

    The derivative that comes with `eigh` divides by every gap and is NaN for symmetric point sets.
    """
    values, vectors = jnp.linalg.eigh(jax.lax.stop_gradient(matrix))
    top, gaps = vectors[:, -1], values[-1] - values[:-1]
    distinct = gaps > 4 * jnp.finfo(matrix.dtype).eps * jnp.abs(values).max()
    inverse = jnp.where(distinct, 1 / jnp.where(distinct, gaps, jnp.ones_like(gaps)), jnp.zeros_like(gaps))
    change = (matrix - jax.lax.stop_gradient(matrix)) @ top
    return top + vectors[:, :-1] @ (inverse * (vectors[:, :-1].T @ change))


def _rotation_3d(p: Float[Array, "N 3"], q: Float[Array, "N 3"], weights: Float[Array, " N"]) -> Float[Array, "3 3"]:
    """The rotation by the quaternion that maximises q^T N q (Horn 1987); coplanar points are no special case."""
    m = (p * weights[:, None]).T @ q
    lower = jnp.stack([m[1, 2] - m[2, 1], m[2, 0] - m[0, 2], m[0, 1] - m[1, 0]])
    trace = jnp.trace(m)
    block = m + m.T - trace * jnp.eye(3, dtype=m.dtype)
    horn = jnp.concatenate(
        [jnp.concatenate([trace[None], lower])[None, :], jnp.concatenate([lower[:, None], block], axis=1)]
    )
    w, x, y, z = _top_eigenvector(horn)
    rotation = jnp.stack(
        [
            jnp.stack([w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)]),
            jnp.stack([2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)]),
            jnp.stack([2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z]),
        ]
    )
    return jnp.where(jnp.any(horn != 0), rotation, jnp.eye(3, dtype=m.dtype))


@jax.jit
def kabsch(
    source: Float[Arrays, "N D"], target: Float[Arrays, "N D"], weights: Float[Arrays, " N"]
) -> tuple[Float[Array, "D D"], Float[Array, " D"]]:
    """Minimises sum w |R source + t - target|^2 over R in SO(D) and t, D = 2 or 3 (Early Bird, eq. 11).

    Args:
      source: points.
      target: their partners.
      weights: >= 0 each; all zero gives R = 1, t = 0.

    Returns:
      R and t, target = R source + t. Exact first derivatives where R is unique.
    """
    p, q, v = jnp.asarray(source), jnp.asarray(target), jnp.asarray(weights)
    p, q, source_mean, target_mean, share = _centred(p, q, v)
    rotation = _rotation_2d(*_dot_cross(p, q, share)) if p.shape[1] == 2 else _rotation_3d(p, q, share)
    return rotation, target_mean - rotation @ source_mean


def _homogeneous(linear: Float[Array, "2 2"], translation: Float[Array, "2"]) -> Float[Array, "3 3"]:
    top = jnp.concatenate([linear, translation[:, None]], axis=1)
    return jnp.concatenate([top, jnp.array([[0, 0, 1]], linear.dtype)])


@jax.jit
def fit_rigid(
    source: Float[Arrays, "N 2"], target: Float[Arrays, "N 2"], weights: Float[Arrays, " N"]
) -> Float[Array, "3 3"]:
    """`kabsch` in the plane as a 3 x 3 matrix."""
    return _homogeneous(*kabsch(source, target, weights))


@jax.jit
def fit_similarity(
    source: Float[Arrays, "N 2"], target: Float[Arrays, "N 2"], weights: Float[Arrays, " N"]
) -> Float[Array, "3 3"]:
    """Minimises sum w |s R source + t - target|^2 over s >= 0, R, t; a 3 x 3 matrix, s = 1 without two points."""
    p, q, v = jnp.asarray(source), jnp.asarray(target), jnp.asarray(weights)
    p, q, source_mean, target_mean, share = _centred(p, q, v)
    dot, cross = _dot_cross(p, q, share)
    spread = jnp.sum(share * (p * p).sum(axis=1))
    some = spread > jnp.finfo(p.dtype).tiny ** 0.5
    spread = jnp.where(some, spread, jnp.ones_like(spread))
    c, s = jnp.where(some, dot / spread, jnp.ones_like(dot)), jnp.where(some, cross / spread, jnp.zeros_like(dot))
    linear = jnp.stack([jnp.stack([c, -s]), jnp.stack([s, c])])
    return _homogeneous(linear, target_mean - linear @ source_mean)


@partial(jax.jit, static_argnames="iterations")
def icp(
    source: Float[Arrays, "N D"],
    target: Float[Arrays, "M D"],
    source_valid: Bool[Arrays, " N"],
    target_valid: Bool[Arrays, " M"],
    init_rotation: Float[Arrays, "D D"],
    init_translation: Float[Arrays, " D"],
    *,
    iterations: int = 20,
    max_distance_m: Scalar = 0.1,
) -> tuple[Float[Array, "D D"], Float[Array, " D"], Bool[Array, " N"]]:
    """Point-to-point ICP (Besl and McKay 1992), pairs beyond a distance left out; O(N M) per iteration.

    Args:
      source: points to move.
      target: points to move them onto.
      source_valid: rows of source that count.
      target_valid: rows of target that count.
      init_rotation: first guess, target = R source + t.
      init_translation: first guess.
      iterations: how many, always all of them.
      max_distance_m: pairs farther apart than this are left out.

    Returns:
      R, t, and the source points within max_distance_m of a target point. With fewer than D pairs the guess stays.
    """
    p, q = jnp.asarray(source), jnp.asarray(target)
    use, other = jnp.asarray(source_valid), jnp.asarray(target_valid)
    p, q = jnp.where(use[:, None], p, jnp.zeros_like(p)), jnp.where(other[:, None], q, jnp.zeros_like(q))

    def pairs(rotation, translation):
        moved = p @ rotation.T + translation[None, :]
        squared = sum((moved[:, None, d] - q[None, :, d]) ** 2 for d in range(p.shape[1]))
        squared = jnp.where(other[None, :], squared, jnp.inf)
        nearest = jnp.argmin(squared, axis=1)
        close = jnp.min(squared, axis=1) <= jnp.asarray(max_distance_m, p.dtype) ** 2
        return nearest, close & use

    def step(_, pose):
        nearest, inliers = pairs(*pose)
        better = kabsch(p, q[nearest], inliers.astype(p.dtype))
        enough = inliers.sum() >= p.shape[1]
        return tuple(jnp.where(enough, new, old) for new, old in zip(better, pose, strict=True))

    start = (jnp.asarray(init_rotation, p.dtype), jnp.asarray(init_translation, p.dtype))
    rotation, translation = jax.lax.fori_loop(0, iterations, step, start)
    return rotation, translation, pairs(rotation, translation)[1]
