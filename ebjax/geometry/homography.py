"""Homographies between planes: p_target = H p_source.

Points are (x, y); pixel centres are at integers, the top-left one at (0, 0). H is defined up to scale: fitted ones have
h33 = 1, ones built from a camera keep w = depth, so that w > 0 means in front of it.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Num

Arrays = Array | np.ndarray
Scalar = float | int | Num[Arrays, ""]


@jax.jit
def denominator(homography: Float[Arrays, "3 3"], points: Float[Arrays, "N 2"]) -> Float[Array, " N"]:
    """The third coordinate w = h31 x + h32 y + h33: zero at the horizon, of one sign on each side of it."""
    h, p = jnp.asarray(homography), jnp.asarray(points)
    return h[2, 0] * p[:, 0] + h[2, 1] * p[:, 1] + h[2, 2]


def safe_denominator(w: Float[Array, "..."], scale: Float[Array, "..."]) -> Float[Array, "..."]:
    """Keeps |w| above rounding error times its scale, and its sign, so that x / w and its gradient stay finite."""
    info = jnp.finfo(w.dtype)
    least = jax.lax.stop_gradient(info.eps * scale + info.tiny**0.5)
    return jnp.where(jnp.abs(w) < least, jnp.where(w < 0, -least, least), w)


@jax.jit
def apply(homography: Float[Arrays, "3 3"], points: Float[Arrays, "N 2"]) -> Float[Array, "N 2"]:
    """Maps points, (x', y') = (h1 p, h2 p) / (h3 p); finite, with a finite gradient, at the horizon too."""
    h, p = jnp.asarray(homography), jnp.asarray(points)
    x, y = p[:, 0], p[:, 1]
    scale = jnp.abs(h[2, 0] * x) + jnp.abs(h[2, 1] * y) + jnp.abs(h[2, 2])
    w = safe_denominator(denominator(h, p), scale)
    return jnp.stack(
        [(h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w, (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w],
        axis=-1,
    )


@jax.jit
def slopes(homography: Float[Arrays, "3 3"], points: Float[Arrays, "N 2"]) -> Float[Array, "N 2 2"]:
    """The derivative of `apply` at points: d(moved x, moved y) / d(x, y)."""
    homography, points = jnp.asarray(homography), jnp.asarray(points)
    moved = apply(homography, points)
    along = homography[None, :2, :2] - moved[:, :, None] * homography[2, :2][None, None]
    return along / denominator(homography, points)[:, None, None]


def orient(homography: Float[Arrays, "3 3"], point: Float[Arrays, "2"]) -> Float[Array, "3 3"]:
    """Flips the sign of H so that w > 0 at a point known to be in front; needed after inverting a fitted homography."""
    h = jnp.asarray(homography)
    return jnp.where(denominator(h, jnp.asarray(point)[None, :])[0] < 0, -h, h)


def unit_h33(homography: Float[Arrays, "3 3"]) -> Float[Array, "3 3"]:
    """Scales H to h33 = 1 (to a large finite matrix when the source's origin lies on the horizon)."""
    h = jnp.asarray(homography)
    return h / safe_denominator(h[2, 2], jnp.max(jnp.abs(h)))


def adjugate(m: Float[Arrays, "3 3"]) -> Float[Array, "3 3"]:
    """The adjugate: det(M) M^-1, the inverse of a homography without a division."""
    a, b, c = jnp.asarray(m)[:, 0], jnp.asarray(m)[:, 1], jnp.asarray(m)[:, 2]
    return jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)])


def normaliser(points: Float[Arrays, "N 2"], weights: Float[Arrays, " N"]) -> Float[Array, "3 3"]:
    """The similarity that moves the weighted centroid to 0 and the rms distance to sqrt(2) (Hartley 1997)."""
    p, v = jnp.asarray(points), jnp.asarray(weights)
    tiny = jnp.finfo(p.dtype).tiny ** 0.5
    total = jnp.sum(v) + tiny
    centre = jnp.sum(v[:, None] * p, axis=0) / total
    spread = jnp.sum(v[:, None] * (p - centre[None, :]) ** 2) / total
    scale = jnp.sqrt(2.0 / jnp.where(spread > tiny, spread, 2.0)).astype(p.dtype)
    zero, one = jnp.zeros((), p.dtype), jnp.ones((), p.dtype)
    return jnp.stack(
        [
            jnp.stack([scale, zero, -scale * centre[0]]),
            jnp.stack([zero, scale, -scale * centre[1]]),
            jnp.stack([zero, zero, one]),
        ]
    )


def _from_basis(points: Float[Array, "4 2"]) -> Float[Array, "3 3"]:
    """The homography that maps e1, e2, e3, e1 + e2 + e3 to the four points."""
    p = jnp.concatenate([points, jnp.ones((4, 1), points.dtype)], axis=1)
    basis = p[:3].T
    return basis * (adjugate(basis) @ p[3])[None, :]


@jax.jit
def from_four_points(source: Float[Arrays, "4 2"], target: Float[Arrays, "4 2"]) -> Float[Array, "3 3"]:
    """The homography through four pairs, H = B_target adj(B_source), h33 = 1.

    Three points on one line give a matrix of no use, yet a finite one; nothing is raised.
    """
    s, t = jnp.asarray(source), jnp.asarray(target)
    ones = jnp.ones(4, s.dtype)
    from_source, from_target = normaliser(s, ones), normaliser(t, ones)
    h = _from_basis(apply(from_target, t)) @ adjugate(_from_basis(apply(from_source, s)))
    return unit_h33(adjugate(from_target) @ h @ from_source)


@jax.jit
def fit(
    source: Float[Arrays, "N 2"], target: Float[Arrays, "N 2"], weights: Float[Arrays, " N"]
) -> Float[Array, "3 3"]:
    """Weighted least squares over x' (h3 p) = h1 p, y' (h3 p) = h2 p in normalised coordinates; h33 = 1.

    The unit coefficient is w at the weighted centroid of the source, which is never on the horizon of points that were
    seen. Differentiable in all arguments. Fewer than four points of positive weight give a finite matrix of no use.

    Args:
      source: points on the first plane.
      target: their partners on the second.
      weights: >= 0 each; they multiply the squared algebraic residuals.
    """
    s, t, v = jnp.asarray(source), jnp.asarray(target), jnp.asarray(weights)
    from_source, from_target = normaliser(s, v), normaliser(t, v)
    p, q = apply(from_source, s), apply(from_target, t)
    lifted = jnp.concatenate([p, jnp.ones((p.shape[0], 1), p.dtype)], axis=1)
    blank = jnp.zeros_like(lifted)
    rows_x = jnp.concatenate([lifted, blank, -q[:, :1] * p], axis=1)
    rows_y = jnp.concatenate([blank, lifted, -q[:, 1:] * p], axis=1)
    v = v / (jnp.sum(v) + jnp.finfo(p.dtype).tiny ** 0.5)
    left = (rows_x * v[:, None]).T @ rows_x + (rows_y * v[:, None]).T @ rows_y
    right = rows_x.T @ (v * q[:, 0]) + rows_y.T @ (v * q[:, 1])
    ridge = 4 * jnp.finfo(p.dtype).eps * jnp.eye(8, dtype=p.dtype)
    h = jnp.linalg.solve(left + ridge, right)
    normalised = jnp.concatenate([h, jnp.ones(1, h.dtype)]).reshape(3, 3)
    return unit_h33(adjugate(from_target) @ normalised @ from_source)


def rotate_pi_matrix(width: int, height: int) -> Float[np.ndarray, "3 3"]:
    """R_pi: (x, y) -> (W - 1 - x, H - 1 - y), the floor seen from the other side, as a matrix."""
    return np.array([[-1.0, 0.0, width - 1.0], [0.0, -1.0, height - 1.0], [0.0, 0.0, 1.0]])


def flip_lr_matrix(width: int, height: int) -> Float[np.ndarray, "3 3"]:
    """(x, y) -> (W - 1 - x, y): a mirror image, which no motion of a robot makes; the height does not matter."""
    del height
    return np.array([[-1.0, 0.0, width - 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
