"""What SE(2) and SE(3) are made of: functions of the angle without cancellation, and products of small matrices.

The logs need one function of s = theta^2, K(s) = (1 - (theta/2) cot(theta/2)) / s. Written by its poles,
K(s) = sum_n 2 / ((2 pi n)^2 - s), it has no branch and no cancellation: three poles and a polynomial for the rest
are exact to rounding for theta <= pi, and so are all derivatives.
"""

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


once = jax.lax.optimization_barrier  # chains of these functions would fuse by computing each anew for every reader


def cot(s: Float[Array, "*b"]) -> tuple[Float[Array, "*b"], Float[Array, "*b"], Float[Array, "*b"]]:
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


def trig(s: Float[Array, "*b"]) -> tuple[Float[Array, "*b"], Float[Array, "*b"], Float[Array, "*b"]]:
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


def small_matmul(a: Float[Array, "*b m k"], b: Float[Array, "*b k n"]) -> Float[Array, "*b m n"]:
    """Products of many small matrices in full precision, as one fused loop: faster than a batched dot on a CPU."""
    return sum((a[..., :, k, None] * b[..., None, k, :] for k in range(1, a.shape[-1])), a[..., :, :1] * b[..., :1, :])


def stack_rows(*rows: list[Float[Array, "*b"]]) -> Float[Array, "*b m n"]:
    """A small matrix from its entries, row by row."""
    return once(jnp.stack([jnp.stack(r, -1) for r in rows], -2))
