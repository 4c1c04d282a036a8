"""Robust kernels rho(s) of the squared, whitened residual s; rho ~ s for small s, so the cost is sum_k rho(s_k).

`width` is in standard deviations: the residual at which a kernel starts to doubt, one for all edges or one per edge.
Cauchy with width 1 is the paper's. Residuals are whitened, so s of a right edge with d numbers is chi-square
distributed with d degrees of freedom: truncated least squares ("tls") wants width^2 at its upper end, and has the
99.9 % point by default.

"gnc-tls" and "gnc-gm" are "tls" and "geman-mcclure" reached by graduated non-convexity (`ebjax.posegraph.gnc`): a
`Graduated` width has a softness too, large where the kernel is nearly quadratic, 0 where it is the kernel itself.
After a choice of loops (`ebjax.posegraph.consensus`) "consensus" is "tls" and "pcm" is "cauchy".

One of your own is a function rho(s, width^2) of JAX arrays, elementwise and differentiable, given as it is or as
`my_package.mine:NAME`, whose code is then run.
"""

import typing
from collections.abc import Callable
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ebjax.parts import OWN, find, is_own

CHI2_99 = {2: 9.210, 3: 11.345, 6: 16.812}  # points of the chi-square distribution by degrees of freedom
CHI2_999 = {2: 13.816, 3: 16.266, 6: 22.458}


class Graduated(NamedTuple):
    """A kernel's width and its softness; softness + 1 is 1 + 1 / mu of gnc-tls, mu of gnc-gm (Yang et al. 2020)."""

    width: Float[Array, "*e"]
    softness: Float[Array, ""]


@typing.runtime_checkable
class Rho(Protocol):
    """A kernel."""

    def __call__(self, s: Float[Array, "*b"], width_squared: Float[Array, "*b"], /) -> Float[Array, "*b"]:
        """rho(s) of squared, whitened residuals s; rho(0) = 0 and rho'(0) = 1, elementwise."""
        ...


Kernel = str | Rho
"""The name of one of ours, or what one of your own is."""
Width = Float[Array, ""] | Float[Array, " E"] | Graduated


def _none(s, w2, t):
    return s


def _cauchy(s, w2, t):
    return w2 * jnp.log1p(s / w2)


def _huber(s, w2, t):
    beyond = s > w2
    return jnp.where(beyond, 2 * jnp.sqrt(w2 * jnp.where(beyond, s, w2)) - w2, s)


def _geman_mcclure(s, w2, t):
    return s * w2 / (s + w2)


def _dcs(s, w2, t):
    return jnp.where(s > w2, w2 * (3 * s - w2) / (s + w2), s)


def _tls(s, w2, t):
    near, far = s <= w2 / (1 + t), s >= w2 * (1 + t)
    between = ~near & ~far
    middle = (2 * jnp.sqrt(w2 * (1 + t) * jnp.where(between, s, 1)) - w2 - s) / jnp.where(between, t, 1)
    return jnp.where(between, middle, jnp.where(near, s, w2))


def _tls_weight(s, w2, t):
    near, far = s <= w2 / (1 + t), s >= w2 * (1 + t)
    between = ~near & ~far
    middle = (jnp.sqrt(w2 * (1 + t) / jnp.where(between, s, 1)) - 1) / jnp.where(between, t, 1)
    return jnp.where(between, middle, jnp.where(near, 1.0, 0.0)).astype(s.dtype)


def _gnc_gm(s, w2, t):
    return _geman_mcclure(s, w2 * (1 + t), 0)


KERNELS: dict[str, Callable] = {
    "none": _none,
    "cauchy": _cauchy,
    "huber": _huber,
    "geman-mcclure": _geman_mcclure,
    "dcs": _dcs,
    "tls": _tls,
    "gnc-tls": _tls,
    "gnc-gm": _gnc_gm,
    "consensus": _tls,
    "pcm": _cauchy,
}

WEIGHTS: dict[str, Callable] = {
    "none": lambda s, w2, t: jnp.ones_like(s),
    "cauchy": lambda s, w2, t: w2 / (w2 + s),
    "huber": lambda s, w2, t: jnp.sqrt(w2 / jnp.maximum(s, w2)),
    "geman-mcclure": lambda s, w2, t: (w2 / (s + w2)) ** 2,
    "dcs": lambda s, w2, t: jnp.minimum(1, 2 * w2 / (s + w2)) ** 2,
    "tls": _tls_weight,
    "gnc-tls": _tls_weight,
    "gnc-gm": lambda s, w2, t: (w2 * (1 + t) / (s + w2 * (1 + t))) ** 2,
    "consensus": _tls_weight,
    "pcm": lambda s, w2, t: w2 / (w2 + s),
}


def chi_square_999(freedom: Int[Array, "*n"]) -> Float[Array, "*n"]:
    """The 99.9 % point of the chi-square distribution, to 2 % (Wilson, Hilferty 1931); 0 without freedom."""
    n = jnp.maximum(freedom, 1).astype(jnp.result_type(float))
    return jnp.where(freedom > 0, n * (1 - 2 / (9 * n) + 3.0902 * jnp.sqrt(2 / (9 * n))) ** 3, 0)


def default_width(kernel: Kernel, dim: int) -> float:
    """1, the paper's; of what cuts off the root of the 99.9 % point of chi-square with `dim` degrees of freedom."""
    return CHI2_999[dim] ** 0.5 if kernel in ("tls", "gnc-tls", "gnc-gm", "consensus") else 1.0


def kernel_of(kernel: Kernel) -> Kernel:
    """The kernel of a name: ours stays a name, one of your own is looked up.

    Raises:
      ValueError: unknown, or no kernel; names the known ones.
    """
    if not isinstance(kernel, str):
        found: Kernel = kernel
    elif is_own(kernel):
        found = find("kernel", kernel, {})
    elif kernel in KERNELS:
        return kernel
    else:
        raise ValueError(f"kernel {kernel!r} is unknown; choose one of {', '.join(KERNELS)}, or {OWN}")
    if not callable(found):
        raise ValueError(f"kernel {kernel!r} is a {type(found).__name__}; give a function rho(s, width^2)")
    return found


def rho(kernel: Kernel, s: Float[Array, "*b"], width: Width) -> Float[Array, "*b"]:
    """The kernel: cauchy w^2 log(1 + s/w^2), huber, geman-mcclure s w^2/(s + w^2), dcs, tls min(s, w^2), none s."""
    w2, softness = _shape(width)
    return KERNELS[kernel](s, w2, softness) if isinstance(kernel, str) else kernel(s, w2)


def weight(kernel: Kernel, s: Float[Array, "*b"], width: Width) -> Float[Array, "*b"]:
    """The derivative d rho / d s: the weight of an edge in iteratively reweighted least squares, in [0, 1]."""
    w2, softness = _shape(width)
    if isinstance(kernel, str):
        return WEIGHTS[kernel](s, w2, softness)
    return jax.jvp(lambda s: kernel(s, w2), (s,), (jnp.ones_like(s),))[1]


def _shape(width):
    width, softness = width if isinstance(width, Graduated) else (width, 0.0)
    return width * width, softness
