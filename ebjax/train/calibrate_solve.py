"""The camera over which matched floor points coincide under odometry.

For a match of rays u, v in frames i, j, with F(m, .) the floor point of a ray under the mount m,

    r = S^-1/2 (i_from_j F(m, v) - F(m, u)),   i_from_j = odometry + L n,   S = A_u A_u^T + R A_v A_v^T R^T,

A being the keypoint's standard deviation carried to the floor by dF: without that factor, which moves with m, the
noise of the matches would pull the floor towards the camera, where everything is smaller. Minimised is

    sum_pairs ( sum_matches width^2 log(1 + r^T r / width^2) + n^T n ) + |(m - start) / sigma|^2

over the mount and, pair by pair, over the errors n of its odometry: the best n of a pair is a function of m (variable
projection), found by Gauss-Newton and differentiated through its last step only (Kaufman 1975). The gradient of the sum
is exact all the same, n being an optimum. What a run does not tell of the mount stays at the start.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float

from ebjax.geometry.homography import Arrays
from ebjax.geometry.mount import Mount, base_from_mounted_camera
from ebjax.train.calibrate_pairs import FloorPairs

INNER_STEPS = 8
MAX_STEPS = 50
LEAST_DOWN = 1e-3
"""Rays flatter than this, m of height per m ahead, are taken to meet the floor at that slope."""


class Solved(NamedTuple):
    """A mount, the cost there, and the distance |r| of every match and the odometry's errors n of every pair."""

    mount: Float[Array, "6"]
    cost: Float[Array, ""]
    distance: Float[Array, "P K"]
    errors: Float[Array, "P 3"]


@jax.jit
def on_floor(
    mount: Mount, rays: Float[Array, "*n 3"], spreads: Float[Array, "*n 3 2"]
) -> tuple[Float[Array, "*n 2"], Float[Array, "*n 2 2"]]:
    """Where rays meet the floor in base, m, and their keypoints' standard deviations there."""
    pose = base_from_mounted_camera(mount)
    ray, spread = rays @ pose[:3, :3].T, jnp.einsum("ab,...bk->...ak", pose[:3, :3], spreads)
    down = jnp.minimum(ray[..., 2:], -LEAST_DOWN)
    reach = -pose[2, 3] / down
    points = reach * ray[..., :2] + pose[:2, 3].reshape(*(1,) * (rays.ndim - 1), 2)
    slopes = reach[..., None] * (spread[..., :2, :] - (ray[..., :2] / down)[..., None] * spread[..., 2:, :])
    return points, slopes


class _Floor(NamedTuple):
    """Floor points of the first and second frames, and the lower Cholesky factor of S by its entries; P x K each."""

    ax: Array
    ay: Array
    bx: Array
    by: Array
    l11: Array
    l21: Array
    l22: Array


def _floor(mount, pairs):
    points, slopes = on_floor(mount, pairs.rays, pairs.spreads)
    c, s = jnp.cos(pairs.motion[:, 2])[:, None, None], jnp.sin(pairs.motion[:, 2])[:, None, None]
    first, second = slopes[:, 0], slopes[:, 1]
    turned = jnp.stack(
        [c * second[..., 0, :] - s * second[..., 1, :], s * second[..., 0, :] + c * second[..., 1, :]], 2
    )
    sides = jnp.concatenate([first, turned], -1)
    xx, xy, yy = (jnp.sum(sides[..., i, :] * sides[..., j, :], -1) for i, j in ((0, 0), (0, 1), (1, 1)))
    l11 = jnp.sqrt(xx)
    l21 = xy / l11
    (ax, ay), (bx, by) = ((points[:, k, :, 0], points[:, k, :, 1]) for k in (0, 1))
    return _Floor(ax, ay, bx, by, l11, l21, jnp.sqrt(yy - l21 * l21))


def _residuals(floor, motion):
    """Returns r of all matches at given motions of the pairs, 2 P K, and its derivative by the motion, 2 P K 3."""
    x, y, c, s = motion[:, 0, None], motion[:, 1, None], jnp.cos(motion[:, 2, None]), jnp.sin(motion[:, 2, None])
    across, along = s * floor.bx + c * floor.by, c * floor.bx - s * floor.by
    one, zero = jnp.ones_like(along), jnp.zeros_like(along)

    def whitened(rx, ry):
        first = rx / floor.l11
        return jnp.stack([first, (ry - floor.l21 * first) / floor.l22])

    slope = jnp.stack([whitened(one, zero), whitened(zero, one), whitened(-across, along)], -1)
    return whitened(along + x - floor.ax, across + y - floor.ay), slope


def _best_errors(floor, pairs, width):
    """The odometry errors of every pair at a mount: reweighted Gauss-Newton, its last step differentiable."""

    def step(errors, floor, frozen):
        motion = pairs.motion + jnp.sum(pairs.noise * errors[:, None, :], -1)
        r, slope = _residuals(frozen, motion)
        slope = jnp.sum(slope[..., :, None] * pairs.noise[None, :, None, :, :], -2)
        weight = pairs.valid / (1 + jnp.sum(r * r, 0) / width**2)
        weighted = slope * weight[None, :, :, None]
        hessian = jnp.einsum("cpka,cpkb->pab", weighted, slope)
        hessian = hessian + jnp.eye(3, dtype=r.dtype)[None]
        gradient = jnp.einsum("cpka,cpk->pa", weighted, _residuals(floor, motion)[0]) + errors
        return errors - jnp.linalg.solve(hessian, gradient[..., None])[..., 0]

    frozen = jax.lax.stop_gradient(floor)
    errors = jnp.zeros_like(pairs.motion)
    errors = jax.lax.fori_loop(0, INNER_STEPS, lambda _, e: step(e, frozen, frozen), errors)
    return step(jax.lax.stop_gradient(errors), floor, frozen)


@jax.jit
def residuals(
    mount: Mount, pairs: FloorPairs, width: float | Float[Array, ""]
) -> tuple[Float[Array, "2 P K"], Float[Array, "P 3"], Float[Array, "P K"]]:
    """What is squared and summed: matches under the Cauchy kernel, odometry errors; and |r| before the kernel."""
    floor = _floor(mount, pairs)
    errors = _best_errors(floor, pairs, width)
    r, _ = _residuals(floor, pairs.motion + jnp.sum(pairs.noise * errors[:, None, :], -1))
    s = jnp.sum(r * r, 0) / width**2
    some = s > 1e-6
    share = jnp.where(some, jnp.log1p(jnp.where(some, s, 1)) / jnp.where(some, s, 1), 1 - s / 2)
    return r * (jnp.sqrt(share) * pairs.valid)[None], errors, width * jnp.sqrt(s + 1e-12)


@jax.jit
def solve(
    start: Mount, sigma: Float[Arrays, "6"], at: Mount, pairs: FloorPairs, width: float | Float[Array, ""]
) -> Solved:
    """Levenberg-Marquardt (optimistix) from the mount `at`.

    Args:
      start: what is believed of the mount beforehand.
      sigma: standard deviations of that belief; zero keeps a number as it is.
      at: where to begin.
      pairs: matches.
      width: of the Cauchy kernel, standard deviations of a match.
    """
    start, sigma = jnp.asarray(start), jnp.asarray(sigma)

    def terms(y, _):
        r, errors, distance = residuals(start + sigma * y, pairs, width)
        return (r, errors, y), (distance, errors, jnp.sum(r**2) + jnp.sum(errors**2) + jnp.sum(y**2))

    begin = jnp.where(sigma > 0, (jnp.asarray(at) - start) / jnp.where(sigma > 0, sigma, 1), 0)
    solver: Any = optx.LevenbergMarquardt(rtol=1e-4, atol=1e-4)
    found: optx.Solution = optx.least_squares(terms, solver, begin, has_aux=True, max_steps=MAX_STEPS, throw=False)
    distance, errors, cost = found.aux
    return Solved(start + sigma * found.value, cost, distance, errors)


@jax.jit
def curvature_sigma(
    sigma: Float[Arrays, "6"], at: Mount, pairs: FloorPairs, width: float | Float[Array, ""]
) -> Float[Array, "6"]:
    """Standard deviations of the mount at the solution `at` by Gauss-Newton, the belief beforehand included.

    Every match counts as independent, so they are too small where the run says much; where it says nothing they are
    those of the belief.
    """
    sigma = jnp.asarray(sigma)

    def terms(y):
        r, errors, _ = residuals(jnp.asarray(at) + sigma * y, pairs, width)
        return jnp.concatenate([r.reshape(-1), errors.reshape(-1), y])

    jacobian = jax.jacfwd(terms)(jnp.zeros_like(sigma))
    return sigma * jnp.sqrt(jnp.diagonal(jnp.linalg.inv(jacobian.T @ jacobian)))


@jax.jit
def count_agreeing(
    mounts: Float[Arrays, "H 6"], pairs: FloorPairs, limit: float | Float[Array, ""]
) -> Float[Array, " H"]:
    """How many matches coincide at every mount, softly: sum max(1 - r^T r / limit^2, 0), odometry taken as it is."""

    def one(mount):
        r, _ = _residuals(_floor(mount, pairs), pairs.motion)
        return jnp.sum(jnp.maximum(1 - jnp.sum(r * r, 0) / limit**2, 0) * pairs.valid)

    return jax.lax.map(one, jnp.asarray(mounts))
