"""From points of the normalised image plane back to rays: Newton, with the derivative of the implicit function."""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ebjax.geometry.lens import STEEPEST, Lens, domain, equidistant, padded, plumb_bob, radial

HALVINGS = 24
ROUNDS = 8
CLOSE = 1e-6
"""Of a point that the inverse leads back to, relative to its distance from the axis plus one."""


def unbend(lens: Lens, points: Float[Array, "N 2"]) -> tuple[Float[Array, "N 3"], Bool[Array, " N"]]:
    """Unit rays of points of the normalised image plane, and which points the lens can show.

    The inverse of `lens.bend`; differentiable, once, in the points and the coefficients. Rays of other points are
    finite and of no use.
    """
    k = jnp.asarray(lens.coefficients, points.dtype)
    if lens.model == "equidistant":
        return _from_equidistant(lens, k, points)
    if lens.model == "pinhole":
        flat, inside = points, jnp.ones(len(points), bool)
    else:
        flat, inside = _from_plumb_bob(lens, padded(lens, k), points)
    square = jnp.sum(flat**2, axis=1)
    if lens.model == "omnidirectional":
        xi = k[0]
        under = 1 + (1 - xi * xi) * square
        inside &= under >= 0
        size = (xi + jnp.sqrt(jnp.where(under > 0, under, 1))) / (1 + square)
        rays = jnp.stack([size * flat[:, 0], size * flat[:, 1], size - xi], axis=1)
    else:
        rays = jnp.stack([flat[:, 0], flat[:, 1], jnp.ones_like(square)], axis=1) / jnp.sqrt(1 + square)[:, None]
    return rays, inside


def _from_plumb_bob(lens: Lens, k: Float[Array, " C"], points: Float[Array, "N 2"]):
    target, still = jax.lax.stop_gradient(points), jax.lax.stop_gradient(k)

    def bent(k, flat):
        return jnp.stack(plumb_bob(k, flat[:, 0], flat[:, 1]), axis=-1)

    most = jnp.minimum(domain(lens, points.dtype), jnp.tan(jnp.asarray(STEEPEST, points.dtype)))
    distance = jnp.sqrt(jnp.sum(target**2, axis=1))
    # Radial terms alone, by halving the angle: they say where to start.
    angle = _halved(lambda a: jnp.tan(a) * radial(still, jnp.tan(a) ** 2), distance, jnp.arctan(most))
    start = target * (jnp.tan(angle) / jnp.where(distance > 0, distance, 1))[:, None]

    def newton(flat, _):
        return flat - _solved(partial(bent, still), flat, bent(still, flat) - target), None

    flat = jax.lax.stop_gradient(jax.lax.scan(newton, start, None, length=ROUNDS)[0])
    missed = jnp.sum((bent(still, flat) - target) ** 2, axis=1)
    inside = (missed <= (CLOSE * (1 + distance)) ** 2) & (jnp.sum(flat**2, axis=1) <= most**2)
    flat = jnp.where(inside[:, None], flat, 0)
    # One step more, whose derivative is that of the implicit function.
    off = jnp.where(inside[:, None], bent(k, flat) - points, 0)
    return flat - _solved(partial(bent, still), flat, off), inside


def _from_equidistant(lens: Lens, k: Float[Array, "4"], points: Float[Array, "N 2"]):
    most = domain(lens, points.dtype)
    still = jax.lax.stop_gradient(k)
    square = jnp.sum(points**2, axis=1)
    on_axis = square <= jnp.finfo(points.dtype).tiny
    distance = jnp.sqrt(jnp.where(on_axis, 1, square))
    target = jnp.where(on_axis, 0, jax.lax.stop_gradient(distance))
    inside = target <= equidistant(still, most)

    def slope(angle):
        return jax.jvp(partial(equidistant, still), (angle,), (jnp.ones_like(angle),))[1]

    def newton(angle, _):
        step = (equidistant(still, angle) - target) / jnp.maximum(slope(angle), 1e-6)
        return jnp.clip(angle - step, 0, most), None

    start = _halved(partial(equidistant, still), target, most)
    angle = jax.lax.scan(newton, start, None, length=ROUNDS)[0]
    angle = jax.lax.stop_gradient(jnp.where(inside, angle, 0))
    off = jnp.where(inside, equidistant(k, angle) - jnp.where(on_axis, 0, distance), 0)
    angle = angle - off / jnp.maximum(slope(angle), 1e-6)
    along = jnp.where(on_axis, 1, jnp.sin(angle) / distance)
    return jnp.concatenate([points * along[:, None], jnp.cos(angle)[:, None]], axis=1), inside


def _halved(
    rising: Callable[[Float[Array, " N"]], Float[Array, " N"]],
    target: Float[Array, " N"],
    most: Float[Array, ""],
) -> Float[Array, " N"]:
    """Where a function that rises from 0 to `most` reaches the targets, roughly."""

    def halve(ends, _):
        middle = (ends[0] + ends[1]) / 2
        under = rising(middle) < target
        return (jnp.where(under, middle, ends[0]), jnp.where(under, ends[1], middle)), None

    ends = jnp.zeros_like(target), jnp.broadcast_to(most, target.shape).astype(target.dtype)
    (low, high), _ = jax.lax.scan(halve, ends, None, length=HALVINGS)
    return (low + high) / 2


def _solved(
    bent: Callable[[Float[Array, "N 2"]], Float[Array, "N 2"]],
    flat: Float[Array, "N 2"],
    off: Float[Array, "N 2"],
) -> Float[Array, "N 2"]:
    """J^-1 off with the 2 x 2 Jacobian of `bent` at every point, which no gradient enters."""
    along = jnp.zeros_like(flat)
    _, x = jax.jvp(bent, (flat,), (along.at[:, 0].set(1),))
    _, y = jax.jvp(bent, (flat,), (along.at[:, 1].set(1),))
    (a, c), (b, d) = jax.lax.stop_gradient((x.T, y.T))
    determinant = a * d - b * c
    determinant = jnp.where(jnp.abs(determinant) > 1e-12, determinant, 1e-12)
    return jnp.stack([d * off[:, 0] - b * off[:, 1], a * off[:, 1] - c * off[:, 0]], axis=1) / determinant[:, None]
