"""SE(2) and SE(3): exp, log and Jacobians with exact values and derivatives at every angle up to pi.

SE(2) poses are (x, y, theta), SE(3) poses (qw, qx, qy, qz, x, y, z) as in jaxlie. Tangents put translation first:
(x, y, theta) and (x, y, z, wx, wy, wz). Any leading axes. Perturbations act on the right: pose * exp(delta).

The logs need one function of s = theta^2, K(s) = (1 - (theta/2) cot(theta/2)) / s. Written by its poles,
K(s) = sum_n 2 / ((2 pi n)^2 - s), it has no branch and no cancellation: three poles and a polynomial for the rest
are exact to rounding for theta <= pi, and so are all derivatives.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

_POLES = tuple((2 * np.pi * n) ** 2 for n in (1, 2, 3))
# 2 zeta(2 k + 2, 4) / (2 pi)^(2 k + 2): what poles four and beyond add to the coefficient of s^k.
_REST = (
    0.01437863891007568,
    9.595555480779428e-06,
    1.1257143383002612e-08,
    1.5388979565181076e-11,
    2.2473189650804126e-14,
    3.394356459763465e-17,
    5.2237546984822245e-20,
    8.127414828310526e-23,
    1.2728430480242665e-25,
    2.0014589986788564e-28,
)


_once = jax.lax.optimization_barrier  # chains of these functions would fuse by computing each anew for every reader


def _cot(s):
    """K(s), K'(s) and K''(s) for 0 <= s <= pi^2."""
    value = slope = bend = jnp.zeros_like(s)
    for c in reversed(_REST):
        bend = bend * s + 2 * slope
        slope = slope * s + value
        value = value * s + c
    for p in _POLES:
        near = 1 / (p - s)
        value = value + 2 * near
        slope = slope + 2 * near**2
        bend = bend + 4 * near**3
    return value, slope, bend


def _series(s, first: int):
    """sum_k (-s)^k / (2 k + first)!, s < 1; first = 1: sin(t)/t, 2: (1 - cos t)/t^2, 3: (t - sin t)/t^3, s = t^2."""
    out = jnp.zeros_like(s)
    for k in reversed(range(10)):
        out = out * -s + 1.0 / float(np.prod(np.arange(1.0, 2 * k + first + 1)))
    return out


def _trig(s):
    """sin(t)/t, (1 - cos t)/t^2 and (t - sin t)/t^3 of s = t^2; series below t = 1 so that derivatives hold at 0."""
    small = s < 1
    low, high = jnp.where(small, s, 0), jnp.where(small, 1, s)
    t = jnp.sqrt(high)
    sinc = jnp.where(small, _series(low, 1), jnp.sin(t) / t)
    cosc = jnp.where(small, _series(low, 2), 2 * (jnp.sin(t / 2) / t) ** 2)
    cubic = jnp.where(small, _series(low, 3), (t - jnp.sin(t)) / (t * high))
    return sinc, cosc, cubic


def wrap_angle(theta_rad: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """Brings angles into [-pi, pi]; the derivative is 1."""
    return theta_rad - 2 * np.pi * jnp.round(theta_rad / (2 * np.pi))


def _rotate2(theta, xy):
    c, s = jnp.cos(theta), jnp.sin(theta)
    return _once(jnp.stack([c * xy[..., 0] - s * xy[..., 1], s * xy[..., 0] + c * xy[..., 1]], -1))


def se2_compose(a_from_b: Float[Array, "*b 3"], b_from_c: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """a_from_c = a_from_b * b_from_c; the angle is wrapped."""
    xy = a_from_b[..., :2] + _rotate2(a_from_b[..., 2], b_from_c[..., :2])
    return _once(jnp.concatenate([xy, wrap_angle(a_from_b[..., 2:] + b_from_c[..., 2:])], -1))


def se2_inverse(a_from_b: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """b_from_a."""
    return _once(jnp.concatenate([-_rotate2(-a_from_b[..., 2], a_from_b[..., :2]), -a_from_b[..., 2:]], -1))


def se2_exp(tangent: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """exp(v, theta) = (V(theta) v, theta), V = [sin t, cos t - 1; 1 - cos t, sin t] / t."""
    theta = tangent[..., 2]
    sinc, cosc, _ = _trig(theta * theta)
    x, y, u = tangent[..., 0], tangent[..., 1], cosc * theta
    return _once(jnp.stack([sinc * x - u * y, u * x + sinc * y, theta], -1))


def se2_log(pose: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """Inverse of `se2_exp` in [-pi, pi]: v = V^-1 t, V^-1 = (theta/2) cot(theta/2) I - (theta/2) [0 -1; 1 0]."""
    theta = wrap_angle(pose[..., 2])
    half, c = theta / 2, 1 - theta * theta * _cot(theta * theta)[0]
    x, y = pose[..., 0], pose[..., 1]
    return _once(jnp.stack([c * x + half * y, c * y - half * x, theta], -1))


def _rows(*rows):
    return _once(jnp.stack([jnp.stack(r, -1) for r in rows], -2))


def se2_adjoint(pose: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """Ad with pose * exp(d) = exp(Ad d) * pose."""
    x, y, c, s = pose[..., 0], pose[..., 1], jnp.cos(pose[..., 2]), jnp.sin(pose[..., 2])
    zero, one = jnp.zeros_like(x), jnp.ones_like(x)
    return _rows([c, -s, y], [s, c, -x], [zero, zero, one])


def se2_log_jacobian(tangent: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """Derivative of log(exp(tangent) * exp(d)) at d = 0, the inverse right Jacobian I + ad/2 + K ad^2."""
    x, y, t = tangent[..., 0], tangent[..., 1], tangent[..., 2]
    k = _cot(t * t)[0]
    c = 1 - t * t * k
    zero, one = jnp.zeros_like(t), jnp.ones_like(t)
    return _rows([c, -t / 2, y / 2 + k * t * x], [t / 2, c, -x / 2 + k * t * y], [zero, zero, one])


def se2_log_jacobian_turn(tangent: Float[Array, "*b 3"], covector: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """Derivative of log_jacobian(tangent)^T covector with respect to tangent, a column per entry of it."""
    x, y, t = tangent[..., 0], tangent[..., 1], tangent[..., 2]
    a, b = covector[..., 0], covector[..., 1]
    k, slope, _ = _once(_cot(t * t))
    dc = -2 * t * (k + t * t * slope)
    zero = jnp.zeros_like(t)
    return _rows(
        [zero, zero, dc * a + b / 2],
        [zero, zero, dc * b - a / 2],
        [k * t * a - b / 2, k * t * b + a / 2, (k + 2 * t * t * slope) * (x * a + y * b)],
    )


def quaternion_multiply(a: Float[Array, "*b 4"], b: Float[Array, "*b 4"]) -> Float[Array, "*b 4"]:
    """Hamilton product, wxyz."""
    aw, ax, ay, az = (a[..., k] for k in range(4))
    bw, bx, by, bz = (b[..., k] for k in range(4))
    rows = jnp.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        -1,
    )
    return _once(rows)


def _rotate3(q, v):
    twice = 2 * jnp.cross(q[..., 1:], v)
    return v + q[..., :1] * twice + jnp.cross(q[..., 1:], twice)


def _conjugate(q):
    return _once(jnp.concatenate([q[..., :1], -q[..., 1:]], -1))


def se3_compose(a_from_b: Float[Array, "*b 7"], b_from_c: Float[Array, "*b 7"]) -> Float[Array, "*b 7"]:
    """a_from_c = a_from_b * b_from_c."""
    q = quaternion_multiply(a_from_b[..., :4], b_from_c[..., :4])
    return _once(jnp.concatenate([q, a_from_b[..., 4:] + _rotate3(a_from_b[..., :4], b_from_c[..., 4:])], -1))


def se3_inverse(a_from_b: Float[Array, "*b 7"]) -> Float[Array, "*b 7"]:
    """b_from_a."""
    q = _conjugate(a_from_b[..., :4])
    return _once(jnp.concatenate([q, -_rotate3(q, a_from_b[..., 4:])], -1))


def se3_exp(tangent: Float[Array, "*b 6"]) -> Float[Array, "*b 7"]:
    """exp(v, w) = (exp(w), V(w) v), V = I + (1 - cos t)/t^2 [w] + (t - sin t)/t^3 [w]^2."""
    v, w = tangent[..., :3], tangent[..., 3:]
    s = jnp.sum(w * w, -1, keepdims=True)
    _, cosc, cubic = _trig(s)
    half_sinc, half_cosc, _ = _trig(s / 4)
    wv = jnp.cross(w, v)
    return _once(
        jnp.concatenate([1 - s / 4 * half_cosc, half_sinc / 2 * w, v + cosc * wv + cubic * jnp.cross(w, wv)], -1)
    )


def _so3_log(q):
    """2 atan(|v| / w) v / |v| of a quaternion (w, v), also where v is zero; -q gives the same."""
    q = jnp.where(q[..., :1] < 0, -q, q)
    w, v = q[..., :1], q[..., 1:]
    n2 = jnp.sum(v * v, -1, keepdims=True)
    small = n2 < 0.04 * w * w
    x = jnp.where(small, n2, 0) / jnp.where(small, w * w, 1)
    series = jnp.zeros_like(x)
    for k in reversed(range(13)):
        series = series * -x + 1.0 / (2 * k + 1)
    n = jnp.sqrt(jnp.where(small, 1, n2))
    return 2 * jnp.where(small, series / jnp.where(small, w, 1), jnp.arctan2(n, w) / n) * v


def se3_log(pose: Float[Array, "*b 7"]) -> Float[Array, "*b 6"]:
    """Inverse of `se3_exp` for angles up to pi: V^-1 = I - [w]/2 + K [w]^2."""
    w, t = _so3_log(pose[..., :4]), pose[..., 4:]
    k = _cot(jnp.sum(w * w, -1, keepdims=True))[0]
    wt = jnp.cross(w, t)
    return _once(jnp.concatenate([t - wt / 2 + k * jnp.cross(w, wt), w], -1))


def small_matmul(a: Float[Array, "*b m k"], b: Float[Array, "*b k n"]) -> Float[Array, "*b m n"]:
    """Products of many small matrices in full precision, as one fused loop: faster than a batched dot on a CPU."""
    return sum((a[..., :, k, None] * b[..., None, k, :] for k in range(1, a.shape[-1])), a[..., :, :1] * b[..., :1, :])


def _hat(w):
    x, y, z = w[..., 0], w[..., 1], w[..., 2]
    o = jnp.zeros_like(x)
    return _rows([o, -z, y], [z, o, -x], [-y, x, o])


def se3_rotation(pose: Float[Array, "*b 7"]) -> Float[Array, "*b 3 3"]:
    """Rotation matrix of a pose with a unit quaternion."""
    w, x, y, z = (pose[..., k] for k in range(4))
    return _rows(
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    )


def _upper(diagonal, corner):
    zero = jnp.zeros_like(diagonal)
    top = jnp.concatenate([diagonal, corner], -1)
    return _once(jnp.concatenate([top, jnp.concatenate([zero, diagonal], -1)], -2))


def se3_adjoint(pose: Float[Array, "*b 7"]) -> Float[Array, "*b 6 6"]:
    """Ad with pose * exp(d) = exp(Ad d) * pose: [R, [t] R; 0, R]."""
    rotation = se3_rotation(pose)
    return _upper(rotation, small_matmul(_hat(pose[..., 4:]), rotation))


def se3_log_jacobian(tangent: Float[Array, "*b 6"]) -> Float[Array, "*b 6 6"]:
    """Derivative of log(exp(tangent) * exp(d)) at d = 0: I + ad/2 + (K - s K') ad^2 - K' ad^4."""
    v, w = _hat(tangent[..., :3]), _hat(tangent[..., 3:])
    s = jnp.sum(tangent[..., 3:] ** 2, -1)[..., None, None]
    k, slope, _ = _cot(s)
    w2, p = small_matmul(w, w), small_matmul(v, w) + small_matmul(w, v)
    return _upper(
        jnp.broadcast_to(jnp.eye(3, dtype=w.dtype), w.shape) + w / 2 + k * w2,
        v / 2 + (k - s * slope) * p - slope * (small_matmul(w2, p) + small_matmul(p, w2)),
    )


def se3_log_jacobian_turn(tangent: Float[Array, "*b 6"], covector: Float[Array, "*b 6"]) -> Float[Array, "*b 6 6"]:
    """Derivative of log_jacobian(tangent)^T covector with respect to tangent, a column per entry of it.

    With tangent (v, w), the rotation's part of the product is f(w, c) = c - w x c / 2 + K w x (w x c). The group being
    that of rotations over dual numbers w + eps v, the rest of it is the derivative of f along v.
    """
    v, w, s = tangent[..., :3], tangent[..., 3:], jnp.sum(tangent[..., 3:] ** 2, -1, keepdims=True)
    k, slope, bend = (value[..., None] for value in _once(_cot(s)))
    dot = lambda a, b: _once(jnp.sum(a * b, -1, keepdims=True))  # noqa: E731
    outer = lambda a, b: a[..., :, None] * b[..., None, :]  # noqa: E731
    eye = jnp.eye(3, dtype=w.dtype).reshape((1,) * (w.ndim - 1) + (3, 3))
    c, wv = covector[..., :3], dot(w, v)

    def bent(c, wc):
        """The derivative of w x (w x c)."""
        return wc[..., None] * eye + outer(w, c) - 2 * outer(c, w)

    def first(c):
        wc = dot(w, c)
        return _once(_hat(c) / 2 + k * bent(c, wc) + 2 * slope * outer(w * wc - s * c, w))

    wc, vc = dot(w, c), dot(v, c)
    double = _once(w * wc - s * c)
    along = _once(wc * v + vc * w - 2 * wv * c)
    second = k * (outer(v, c) + vc[..., None] * eye - 2 * outer(c, v)) + 2 * slope * (
        outer(along, w) + outer(double, v) + wv[..., None] * bent(c, wc)
    )
    second = second + 4 * bend * outer(wv * double, w)
    top = first(c)
    rows = (
        jnp.concatenate([jnp.zeros_like(top), top], -1),
        jnp.concatenate([top, first(covector[..., 3:]) + second], -1),
    )
    return _once(jnp.concatenate(rows, -2))


class Group(NamedTuple):
    """What a pose graph needs of a Lie group: `size` numbers a pose, `dim` numbers a tangent.

    `bracket[k, l]` is [e_k, e_l], the structure constants.
    """

    size: int
    dim: int
    compose: Callable
    inverse: Callable
    exp: Callable
    log: Callable
    adjoint: Callable
    log_jacobian: Callable
    log_jacobian_turn: Callable
    normalise: Callable
    identity: tuple[float, ...]
    bracket: np.ndarray


def _se2_normalise(pose):
    return _once(jnp.concatenate([pose[..., :2], wrap_angle(pose[..., 2:])], -1))


def _se3_normalise(pose):
    q = pose[..., :4] / jnp.linalg.norm(pose[..., :4], axis=-1, keepdims=True)
    return _once(jnp.concatenate([q, pose[..., 4:]], -1))


def _bracket2():
    out = np.zeros((3, 3, 3))
    out[2, 0, 1] = out[1, 2, 0] = 1
    return out - out.swapaxes(0, 1)


def _bracket3():
    cross = np.zeros((3, 3, 3))
    cross[0, 1, 2] = cross[1, 2, 0] = cross[2, 0, 1] = 1
    cross = cross - cross.swapaxes(0, 1)
    out = np.zeros((6, 6, 6))
    out[3:, 3:, 3:] = out[3:, :3, :3] = out[:3, 3:, :3] = cross
    return out


_SE2 = (
    se2_compose,
    se2_inverse,
    se2_exp,
    se2_log,
    se2_adjoint,
    se2_log_jacobian,
    se2_log_jacobian_turn,
    _se2_normalise,
)
_SE3 = (
    se3_compose,
    se3_inverse,
    se3_exp,
    se3_log,
    se3_adjoint,
    se3_log_jacobian,
    se3_log_jacobian_turn,
    _se3_normalise,
)
GROUPS = {
    "se2": Group(3, 3, *_SE2, (0.0, 0.0, 0.0), _bracket2()),
    "se3": Group(7, 6, *_SE3, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), _bracket3()),
}
