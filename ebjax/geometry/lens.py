"""Lenses that bend: rays of the camera to points of the normalised image plane, by OpenCV's formulas.

A pinhole's point of a ray is (x / z, y / z); pixels are K times the bent point. `lens_models` names the lenses and
their coefficients. Outside a lens's domain, behind it or beyond where its image folds back, nothing is seen.
"""

import dataclasses
import math
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ebjax.geometry.homography import Arrays
from ebjax.geometry.lens_models import lens_fault
from ebjax.geometry.pytree import pytree

SAMPLES = 1025
HALVINGS = 48
SERIES = {4: 5, 8: 11}
"""Terms of an arctangent's series below tan(pi / 16), by a float's bytes: it ends below its rounding."""
STEEPEST = math.radians(89.9)
"""Plumb-bob lenses are looked at up to this angle from the optical axis."""


@pytree
class Lens:
    """A distortion model by ROS's name, and its coefficients in OpenCV's order."""

    coefficients: Float[Arrays, " C"]
    model: str = dataclasses.field(metadata=dict(static=True))


PINHOLE = Lens(np.zeros(0), "pinhole")


def lens(model: str, coefficients: tuple[float, ...] | list[float]) -> Lens:
    """A lens by its name.

    Raises:
      ValueError: an unknown name, or a wrong number of coefficients.
    """
    if fault := lens_fault(model, tuple(coefficients)):
        raise ValueError(fault)
    return Lens(np.array(coefficients, np.float64), model)


def bend(lens: Lens, rays: Float[Array, "N 3"]) -> tuple[Float[Array, "N 2"], Bool[Array, " N"]]:
    """Points of the normalised image plane of rays of any length, and which lie in the lens's domain.

    Differentiable in the rays and the coefficients. Points outside the domain are finite and of no use.
    """
    x, y, inside = bend_parts(lens, rays[:, 0], rays[:, 1], rays[:, 2])
    return jnp.stack([x, y], axis=-1), inside


def bend_parts(
    lens: Lens, x: Float[Array, " N"], y: Float[Array, " N"], z: Float[Array, " N"]
) -> tuple[Float[Array, " N"], Float[Array, " N"], Bool[Array, " N"]]:
    """`bend` of rays (x, y, z), each axis in an array of its own."""
    k = jnp.asarray(lens.coefficients, x.dtype)
    limit = domain(lens, x.dtype)
    across = x * x + y * y
    if lens.model == "equidistant":
        turn = angle_over_distance(across, z)
        scale = turn * _polynomial(k, across * turn * turn)
        behind = (across <= jnp.finfo(x.dtype).tiny) & (z <= 0)
        return x * scale, y * scale, ~behind & (across * turn * turn <= limit * limit)
    if lens.model == "omnidirectional":
        xi, size = k[0], jnp.sqrt(across + z * z)
        cosine = z / jnp.where(size > 0, size, 1)
        ahead = (size > 0) & (cosine > -jnp.minimum(xi, 1 / jnp.maximum(xi, 1e-6)))
        z = z + xi * size
    else:
        ahead = z > 0
    inverse = 1 / jnp.where(ahead, z, 1)
    x, y = x * inverse, y * inverse
    inside = ahead & (x * x + y * y <= limit * limit)
    if lens.model == "pinhole":
        return x, y, inside
    return *plumb_bob(padded(lens, k), x, y), inside


def angle_over_distance(across: Float[Array, " N"], z: Float[Array, " N"]) -> Float[Array, " N"]:
    """Theta / r of rays at the distance r from the optical axis, given r^2 and z: smooth on the axis, 1 / z there.

    tan(theta / 2) = r / (sqrt(r^2 + z^2) + z); halved three times more it is so small that a few terms of its
    arctangent's series do, which vectorise where arctan2 does not.
    """
    whole = jnp.sqrt(across + z * z) + z
    over = 1 / jnp.where(whole > 0, whole, 1)
    for _ in range(3):
        over = over / (1 + jnp.sqrt(1 + across * over * over))
    square = across * over * over
    series = jnp.zeros_like(square)
    for n in range(SERIES[square.dtype.itemsize], -1, -1):
        series = (-1) ** n / (2 * n + 1) + square * series
    return 16 * over * series


def domain(lens: Lens, dtype: np.dtype | type) -> Float[Array, ""]:
    """How far from the optical axis the image of a lens does not fold back.

    An angle (rad, at most pi) for an equidistant lens; else the radius of the point before it is bent, inf where it
    never folds. No gradient.
    """
    k = jax.lax.stop_gradient(jnp.asarray(lens.coefficients, dtype))
    if lens.model == "pinhole":
        return jnp.asarray(jnp.inf, dtype)
    if lens.model == "equidistant":
        return _first_fold(partial(equidistant, k), jnp.linspace(0, math.pi, SAMPLES, dtype=dtype), math.pi)
    wide = jnp.tan(jnp.linspace(0, STEEPEST, SAMPLES, dtype=dtype))
    terms = padded(lens, k)
    return _first_fold(lambda r: r * radial(terms, r * r), wide, math.inf)


def plumb_bob(
    k: Float[Array, " C"], x: Float[Array, " N"], y: Float[Array, " N"]
) -> tuple[Float[Array, " N"], Float[Array, " N"]]:
    """OpenCV's radial, tangential, thin-prism and tilted-sensor terms of points on the normalised plane."""
    r2 = x * x + y * y
    factor, cross = radial(k, r2), 2 * x * y
    bent_x = x * factor + k[2] * cross + k[3] * (r2 + 2 * x * x) + r2 * (k[8] + k[9] * r2)
    bent_y = y * factor + k[2] * (r2 + 2 * y * y) + k[3] * cross + r2 * (k[10] + k[11] * r2)
    if len(k) < 14:
        return bent_x, bent_y
    (sx, cx), (sy, cy) = ((jnp.sin(angle), jnp.cos(angle)) for angle in (k[12], k[13]))
    # R_y R_x, and what brings its third axis back onto the optical one.
    tilted_x = cy * bent_x + sy * sx * bent_y - sy * cx
    tilted_y = cx * bent_y + sx
    depth = sy * bent_x - cy * sx * bent_y + cy * cx
    return (cy * cx * tilted_x + sy * cx * depth) / depth, (cy * cx * tilted_y - sx * depth) / depth


def equidistant(k: Float[Array, "4"], angle: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Bent angle: theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8) (Kannala and Brandt, 2006)."""
    return angle * _polynomial(k, angle * angle)


def _polynomial(k: Float[Array, "4"], t: Float[Array, "*n"]) -> Float[Array, "*n"]:
    return 1 + t * (k[0] + t * (k[1] + t * (k[2] + t * k[3])))


def radial(k: Float[Array, " C"], r2: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """OpenCV's radial factor of the squared distance from the axis."""
    return (1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))


def padded(lens: Lens, k: Float[Array, " C"]) -> Float[Array, " D"]:
    """OpenCV's 12 coefficients of a plumb-bob lens, or of the plane behind Mei's sphere; 14 where its sensor tilts."""
    k = k[1:] if lens.model == "omnidirectional" else k
    return jnp.concatenate([k, jnp.zeros(max(0, 12 - k.shape[0]), k.dtype)])


def _first_fold(
    bent: Callable[[Float[Array, "*n"]], Float[Array, "*n"]], samples: Float[Array, " S"], most: float
) -> Float[Array, ""]:
    """The first sample-free zero of the derivative of `bent`, found between samples by halving; else `most`."""

    def rises(at):
        value, slope = jax.jvp(bent, (at,), (jnp.ones_like(at),))
        return (slope > 0) & (value >= 0)

    good = rises(samples)
    first = jnp.argmin(good)

    def halve(ends, _):
        middle = (ends[0] + ends[1]) / 2
        up = rises(middle)
        return (jnp.where(up, middle, ends[0]), jnp.where(up, ends[1], middle)), None

    start = samples[jnp.maximum(first - 1, 0)], samples[first]
    (low, _), _ = jax.lax.scan(halve, start, None, length=HALVINGS)
    return jnp.where(jnp.all(good), jnp.asarray(most, samples.dtype), low)
