"""SE(3): exp, log and Jacobians with exact values and derivatives at every angle up to pi.

Poses are (qw, qx, qy, qz, x, y, z) as in jaxlie; tangents put translation first, (x, y, z, wx, wy, wz). Any leading
axes. Perturbations act on the right: pose * exp(delta).
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ebjax.geometry.small_angle import cot, once, small_matmul, stack_rows, trig


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
    return once(rows)


def _rotate3(q, v):
    twice = 2 * jnp.cross(q[..., 1:], v)
    return v + q[..., :1] * twice + jnp.cross(q[..., 1:], twice)


def _conjugate(q):
    return once(jnp.concatenate([q[..., :1], -q[..., 1:]], -1))


def compose(a_from_b: Float[Array, "*b 7"], b_from_c: Float[Array, "*b 7"]) -> Float[Array, "*b 7"]:
    """a_from_c = a_from_b * b_from_c."""
    q = quaternion_multiply(a_from_b[..., :4], b_from_c[..., :4])
    return once(jnp.concatenate([q, a_from_b[..., 4:] + _rotate3(a_from_b[..., :4], b_from_c[..., 4:])], -1))


def inverse(a_from_b: Float[Array, "*b 7"]) -> Float[Array, "*b 7"]:
    """b_from_a."""
    q = _conjugate(a_from_b[..., :4])
    return once(jnp.concatenate([q, -_rotate3(q, a_from_b[..., 4:])], -1))


def exp(tangent: Float[Array, "*b 6"]) -> Float[Array, "*b 7"]:
    """The pose (exp(w), V(w) v) of a tangent (v, w), V = I + (1 - cos t)/t^2 [w] + (t - sin t)/t^3 [w]^2."""
    v, w = tangent[..., :3], tangent[..., 3:]
    s = jnp.sum(w * w, -1, keepdims=True)
    _, cosc, cubic = trig(s)
    half_sinc, half_cosc, _ = trig(s / 4)
    wv = jnp.cross(w, v)
    return once(
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


def log(pose: Float[Array, "*b 7"]) -> Float[Array, "*b 6"]:
    """Inverse of `exp` for angles up to pi: V^-1 = I - [w]/2 + K [w]^2."""
    w, t = _so3_log(pose[..., :4]), pose[..., 4:]
    k = cot(jnp.sum(w * w, -1, keepdims=True))[0]
    wt = jnp.cross(w, t)
    return once(jnp.concatenate([t - wt / 2 + k * jnp.cross(w, wt), w], -1))


def _hat(w):
    x, y, z = w[..., 0], w[..., 1], w[..., 2]
    o = jnp.zeros_like(x)
    return stack_rows([o, -z, y], [z, o, -x], [-y, x, o])


def rotation(pose: Float[Array, "*b 7"]) -> Float[Array, "*b 3 3"]:
    """Rotation matrix of a pose with a unit quaternion."""
    w, x, y, z = (pose[..., k] for k in range(4))
    return stack_rows(
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    )


def _upper(diagonal, corner):
    zero = jnp.zeros_like(diagonal)
    top = jnp.concatenate([diagonal, corner], -1)
    return once(jnp.concatenate([top, jnp.concatenate([zero, diagonal], -1)], -2))


def adjoint(pose: Float[Array, "*b 7"]) -> Float[Array, "*b 6 6"]:
    """Ad with pose * exp(d) = exp(Ad d) * pose: [R, [t] R; 0, R]."""
    turn = rotation(pose)
    return _upper(turn, small_matmul(_hat(pose[..., 4:]), turn))


def log_jacobian(tangent: Float[Array, "*b 6"]) -> Float[Array, "*b 6 6"]:
    """Derivative of log(exp(tangent) * exp(d)) at d = 0: I + ad/2 + (K - s K') ad^2 - K' ad^4."""
    v, w = _hat(tangent[..., :3]), _hat(tangent[..., 3:])
    s = jnp.sum(tangent[..., 3:] ** 2, -1)[..., None, None]
    k, slope, _ = cot(s)
    w2, p = small_matmul(w, w), small_matmul(v, w) + small_matmul(w, v)
    return _upper(
        jnp.broadcast_to(jnp.eye(3, dtype=w.dtype), w.shape) + w / 2 + k * w2,
        v / 2 + (k - s * slope) * p - slope * (small_matmul(w2, p) + small_matmul(p, w2)),
    )


def log_jacobian_turn(tangent: Float[Array, "*b 6"], covector: Float[Array, "*b 6"]) -> Float[Array, "*b 6 6"]:
    """Derivative of log_jacobian(tangent)^T covector with respect to tangent, a column per entry of it.

    With tangent (v, w), the rotation's part of the product is f(w, c) = c - w x c / 2 + K w x (w x c). The group being
    that of rotations over dual numbers w + eps v, the rest of it is the derivative of f along v.
    """
    v, w, s = tangent[..., :3], tangent[..., 3:], jnp.sum(tangent[..., 3:] ** 2, -1, keepdims=True)
    k, slope, bend = (value[..., None] for value in once(cot(s)))
    dot = lambda a, b: once(jnp.sum(a * b, -1, keepdims=True))  # noqa: E731
    outer = lambda a, b: a[..., :, None] * b[..., None, :]  # noqa: E731
    eye = jnp.eye(3, dtype=w.dtype).reshape((1,) * (w.ndim - 1) + (3, 3))
    c, wv = covector[..., :3], dot(w, v)

    def bent(c, wc):
        """The derivative of w x (w x c)."""
        return wc[..., None] * eye + outer(w, c) - 2 * outer(c, w)

    def first(c):
        wc = dot(w, c)
        return once(_hat(c) / 2 + k * bent(c, wc) + 2 * slope * outer(w * wc - s * c, w))

    wc, vc = dot(w, c), dot(v, c)
    double = once(w * wc - s * c)
    along = once(wc * v + vc * w - 2 * wv * c)
    second = k * (outer(v, c) + vc[..., None] * eye - 2 * outer(c, v)) + 2 * slope * (
        outer(along, w) + outer(double, v) + wv[..., None] * bent(c, wc)
    )
    second = second + 4 * bend * outer(wv * double, w)
    top = first(c)
    rows = (
        jnp.concatenate([jnp.zeros_like(top), top], -1),
        jnp.concatenate([top, first(covector[..., 3:]) + second], -1),
    )
    return once(jnp.concatenate(rows, -2))


def left_tangent(pose: Float[Array, "*b 7"], change: Float[Array, "*b 7"]) -> Float[Array, "*b 6"]:
    """The tangent d of the change of a pose's numbers: pose + change is exp(d) * pose to first order.

    What would only lengthen the quaternion does not count.
    """
    w = 2 * quaternion_multiply(change[..., :4], _conjugate(pose[..., :4]))[..., 1:]
    return once(jnp.concatenate([change[..., 4:] - jnp.cross(w, pose[..., 4:]), w], -1))


def normalise(pose: Float[Array, "*b 7"]) -> Float[Array, "*b 7"]:
    """Makes the quaternion a unit one."""
    q = pose[..., :4] / jnp.linalg.norm(pose[..., :4], axis=-1, keepdims=True)
    return once(jnp.concatenate([q, pose[..., 4:]], -1))


def bracket() -> np.ndarray:
    """[e_k, e_l] as bracket[k, l]."""
    cross = np.zeros((3, 3, 3))
    cross[0, 1, 2] = cross[1, 2, 0] = cross[2, 0, 1] = 1
    cross = cross - cross.swapaxes(0, 1)
    out = np.zeros((6, 6, 6))
    out[3:, 3:, 3:] = out[3:, :3, :3] = out[:3, 3:, :3] = cross
    return out
