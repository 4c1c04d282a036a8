"""Robust kernels rho(s) of the squared, whitened residual s; rho ~ s for small s, so the cost is sum_k rho(s_k).

`width` is in standard deviations: the residual at which a kernel starts to doubt. Cauchy with width 1 is the paper's.
"""

from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array, Float


def _none(s, w2):
    return s


def _cauchy(s, w2):
    return w2 * jnp.log1p(s / w2)


def _huber(s, w2):
    beyond = s > w2
    return jnp.where(beyond, 2 * jnp.sqrt(w2 * jnp.where(beyond, s, w2)) - w2, s)


def _geman_mcclure(s, w2):
    return s * w2 / (s + w2)


def _dcs(s, w2):
    return jnp.where(s > w2, w2 * (3 * s - w2) / (s + w2), s)


KERNELS: dict[str, Callable] = {
    "none": _none,
    "cauchy": _cauchy,
    "huber": _huber,
    "geman-mcclure": _geman_mcclure,
    "dcs": _dcs,
}

WEIGHTS: dict[str, Callable] = {
    "none": lambda s, w2: jnp.ones_like(s),
    "cauchy": lambda s, w2: w2 / (w2 + s),
    "huber": lambda s, w2: jnp.sqrt(w2 / jnp.maximum(s, w2)),
    "geman-mcclure": lambda s, w2: (w2 / (s + w2)) ** 2,
    "dcs": lambda s, w2: jnp.minimum(1, 2 * w2 / (s + w2)) ** 2,
}


def rho(kernel: str, s: Float[Array, "*b"], width: Float[Array, ""]) -> Float[Array, "*b"]:
    """The kernel's cost: cauchy w^2 log(1 + s/w^2), huber, geman-mcclure s w^2/(s + w^2), dcs, none s."""
    return KERNELS[kernel](s, width * width)


def weight(kernel: str, s: Float[Array, "*b"], width: Float[Array, ""]) -> Float[Array, "*b"]:
    """The derivative d rho / d s: the weight of an edge in iteratively reweighted least squares, in [0, 1]."""
    return WEIGHTS[kernel](s, width * width)
