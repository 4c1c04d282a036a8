"""SE(2): exp, log and Jacobians with exact values and derivatives at every angle up to pi.

Poses are (x, y, theta), as tangents are. Any leading axes. Perturbations act on the right: pose * exp(delta).
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ebjax.geometry.small_angle import cot, once, stack_rows, trig, wrap_angle


def _rotate2(theta, xy):
    c, s = jnp.cos(theta), jnp.sin(theta)
    return once(jnp.stack([c * xy[..., 0] - s * xy[..., 1], s * xy[..., 0] + c * xy[..., 1]], -1))


def compose(a_from_b: Float[Array, "*b 3"], b_from_c: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """a_from_c = a_from_b * b_from_c; the angle is wrapped."""
    xy = a_from_b[..., :2] + _rotate2(a_from_b[..., 2], b_from_c[..., :2])
    return once(jnp.concatenate([xy, wrap_angle(a_from_b[..., 2:] + b_from_c[..., 2:])], -1))


def inverse(a_from_b: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """b_from_a."""
    return once(jnp.concatenate([-_rotate2(-a_from_b[..., 2], a_from_b[..., :2]), -a_from_b[..., 2:]], -1))


def exp(tangent: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """The pose (V(theta) v, theta) of a tangent (v, theta), V = [sin t, cos t - 1; 1 - cos t, sin t] / t."""
    theta = tangent[..., 2]
    sinc, cosc, _ = trig(theta * theta)
    x, y, u = tangent[..., 0], tangent[..., 1], cosc * theta
    return once(jnp.stack([sinc * x - u * y, u * x + sinc * y, theta], -1))


def log(pose: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """Inverse of `exp` in [-pi, pi]: v = V^-1 t, V^-1 = (theta/2) cot(theta/2) I - (theta/2) [0 -1; 1 0]."""
    theta = wrap_angle(pose[..., 2])
    half, c = theta / 2, 1 - theta * theta * cot(theta * theta)[0]
    x, y = pose[..., 0], pose[..., 1]
    return once(jnp.stack([c * x + half * y, c * y - half * x, theta], -1))


def adjoint(pose: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """Ad with pose * exp(d) = exp(Ad d) * pose."""
    x, y, c, s = pose[..., 0], pose[..., 1], jnp.cos(pose[..., 2]), jnp.sin(pose[..., 2])
    zero, one = jnp.zeros_like(x), jnp.ones_like(x)
    return stack_rows([c, -s, y], [s, c, -x], [zero, zero, one])


def log_jacobian(tangent: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """Derivative of log(exp(tangent) * exp(d)) at d = 0, the inverse right Jacobian I + ad/2 + K ad^2."""
    x, y, t = tangent[..., 0], tangent[..., 1], tangent[..., 2]
    k = cot(t * t)[0]
    c = 1 - t * t * k
    zero, one = jnp.zeros_like(t), jnp.ones_like(t)
    return stack_rows([c, -t / 2, y / 2 + k * t * x], [t / 2, c, -x / 2 + k * t * y], [zero, zero, one])


def log_jacobian_turn(tangent: Float[Array, "*b 3"], covector: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """Derivative of log_jacobian(tangent)^T covector with respect to tangent, a column per entry of it."""
    x, y, t = tangent[..., 0], tangent[..., 1], tangent[..., 2]
    a, b = covector[..., 0], covector[..., 1]
    k, slope, _ = once(cot(t * t))
    dc = -2 * t * (k + t * t * slope)
    zero = jnp.zeros_like(t)
    return stack_rows(
        [zero, zero, dc * a + b / 2],
        [zero, zero, dc * b - a / 2],
        [k * t * a - b / 2, k * t * b + a / 2, (k + 2 * t * t * slope) * (x * a + y * b)],
    )


def left_tangent(pose: Float[Array, "*b 3"], change: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """The tangent d of the change of a pose's numbers: pose + change is exp(d) * pose to first order."""
    x, y, turn = change[..., 0], change[..., 1], change[..., 2]
    return once(jnp.stack([x + turn * pose[..., 1], y - turn * pose[..., 0], turn], -1))


def normalise(pose: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """Wraps the angle."""
    return once(jnp.concatenate([pose[..., :2], wrap_angle(pose[..., 2:])], -1))


def bracket() -> np.ndarray:
    """[e_k, e_l] as bracket[k, l]."""
    out = np.zeros((3, 3, 3))
    out[2, 0, 1] = out[1, 2, 0] = 1
    return out - out.swapaxes(0, 1)
