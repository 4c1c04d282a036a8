"""The camera under which matched floor points coincide under odometry.

For a match of raw pixels u, v in frames i, j, with F(c, .) the floor point of a pixel under the camera c,

    r = S^-1/2 (i_from_j F(c, v) - F(c, u)),   i_from_j = odometry + L n,   S = A_u A_u^T + R A_v A_v^T R^T,

A being the keypoint's standard deviation carried to the floor by dF: without that factor, which moves with c, the
noise of the matches would pull the floor towards the camera, where everything is smaller. Minimised is

    sum_pairs ( sum_matches width^2 log(1 + r^T r / width^2) + n^T n ) + |(c - start) / sigma|^2

over the camera's numbers (`calibrate_camera`) and, pair by pair, over the errors n of its odometry: the best n of a
pair is a function of c (variable projection), found by Gauss-Newton and differentiated through its last step only
(Kaufman 1975). The gradient of the sum is exact all the same, n being an optimum. What a run does not tell of the
camera stays at the start: motion over a plane tells F over the part of the image that sees the floor, so all that a
homography cannot undo (the lens), but of ten numbers of mount and K only the eight of a homography.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from ebjax.geometry.homography import Arrays
from ebjax.train.calibrate_camera import MOUNT, Numbers, with_numbers
from ebjax.train.calibrate_floor import Rays, on_floor, rays_of_pixels
from ebjax.train.calibrate_pairs import FloorPairs

INNER_STEPS = 8
MAX_STEPS = 50
LOST = 100.0
"""What a match counts one of whose pixels the lens cannot show, standard deviations: as much as a very wrong one."""


class Solved(NamedTuple):
    """A camera's numbers, the cost there, the distance |r| of every match, the odometry's errors n of every pair."""

    numbers: Float[Array, " N"]
    cost: Float[Array, ""]
    distance: Float[Array, "P K"]
    errors: Float[Array, "P 3"]


class _Floor(NamedTuple):
    """Floor points of both frames, the lower Cholesky factor of S by its entries, and which exist; P x K each."""

    ax: Array
    ay: Array
    bx: Array
    by: Array
    l11: Array
    l21: Array
    l22: Array
    there: Bool[Array, "P K"]


def _floor(mount: Numbers, rays: Rays, pairs: FloorPairs) -> _Floor:
    points, slopes = on_floor(mount, rays.rays, rays.spreads)
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
    return _Floor(ax, ay, bx, by, l11, l21, jnp.sqrt(yy - l21 * l21), rays.there.all(1))


def _rays(numbers: Numbers, pairs: FloorPairs) -> Rays:
    return rays_of_pixels(with_numbers(pairs.camera, numbers), pairs.pixels, pairs.slopes)


_rays_once = jax.jit(_rays)


def _rays_if_kept(numbers: Numbers, free: Int[np.ndarray, " V"], pairs: FloorPairs) -> Rays | None:
    """The rays of all pixels, once for all steps where only the mount moves."""
    return _rays_once(np.asarray(numbers), pairs) if (free < MOUNT.stop).all() else None


def _residuals(floor, motion):
    """Returns r of all matches at given motions of the pairs, 2 P K, and its derivative by the motion, 2 P K 3."""
    x, y, c, s = motion[:, 0, None], motion[:, 1, None], jnp.cos(motion[:, 2, None]), jnp.sin(motion[:, 2, None])
    across, along = s * floor.bx + c * floor.by, c * floor.bx - s * floor.by
    one, zero = jnp.ones_like(along), jnp.zeros_like(along)

    def whitened(rx, ry, lost=0.0):
        first = rx / floor.l11
        second = (ry - floor.l21 * first) / floor.l22
        return jnp.where(floor.there, jnp.stack([first, second]), lost)

    slope = jnp.stack([whitened(one, zero), whitened(zero, one), whitened(-across, along)], -1)
    return whitened(along + x - floor.ax, across + y - floor.ay, LOST), slope


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
    numbers: Numbers, pairs: FloorPairs, width: float | Float[Array, ""], rays: Rays | None = None
) -> tuple[Float[Array, "2 P K"], Float[Array, "P 3"], Float[Array, "P K"]]:
    """What is squared and summed: matches under the Cauchy kernel, odometry errors; and |r| before the kernel.

    Args:
      numbers: of the camera.
      pairs: matches.
      width: of the kernel, standard deviations of a match.
      rays: of the matches under these optics, where they are known already.
    """
    numbers = jnp.asarray(numbers)
    floor = _floor(numbers[MOUNT], _rays(numbers, pairs) if rays is None else rays, pairs)
    errors = _best_errors(floor, pairs, width)
    r, _ = _residuals(floor, pairs.motion + jnp.sum(pairs.noise * errors[:, None, :], -1))
    s = jnp.sum(r * r, 0) / width**2
    some = s > 1e-6
    share = jnp.where(some, jnp.log1p(jnp.where(some, s, 1)) / jnp.where(some, s, 1), 1 - s / 2)
    return r * (jnp.sqrt(share) * pairs.valid)[None], errors, width * jnp.sqrt(s + 1e-12)


def solve(start: Numbers, sigma: Numbers, at: Numbers, pairs: FloorPairs, width: float) -> Solved:
    """Levenberg-Marquardt (optimistix) from the numbers `at`.

    Args:
      start: what is believed of the camera beforehand.
      sigma: standard deviations of that belief; zero keeps a number as it is at the start.
      at: where to begin.
      pairs: matches.
      width: of the Cauchy kernel, standard deviations of a match.
    """
    free = np.flatnonzero(sigma)
    rays = _rays_if_kept(start, free, pairs)
    return _solve(np.asarray(start), np.asarray(sigma)[free], np.asarray(at)[free], free, pairs, width, rays)


@jax.jit
def _solve(
    start: Float[Array, " N"],
    sigma: Float[Array, " V"],
    at: Float[Array, " V"],
    free: Int[Arrays, " V"],
    pairs: FloorPairs,
    width: float | Float[Array, ""],
    rays: Rays | None,
) -> Solved:
    def terms(y, _):
        r, errors, distance = residuals(start.at[free].add(sigma * y), pairs, width, rays)
        return (r, errors, y), (distance, errors, jnp.sum(r**2) + jnp.sum(errors**2) + jnp.sum(y**2))

    begin = (at - start[free]) / sigma
    solver: Any = optx.LevenbergMarquardt(rtol=1e-4, atol=1e-4)
    found: optx.Solution = optx.least_squares(terms, solver, begin, has_aux=True, max_steps=MAX_STEPS, throw=False)
    distance, errors, cost = found.aux
    return Solved(start.at[free].add(sigma * found.value), cost, distance, errors)


def curvature_sigma(sigma: Numbers, at: Numbers, pairs: FloorPairs, width: float) -> Float[np.ndarray, " N"]:
    """Standard deviations of the numbers at the solution `at` by Gauss-Newton, the belief beforehand included.

    Every match counts as independent, so they are too small where the run says much; where it says nothing they are
    those of the belief.
    """
    free, found = np.flatnonzero(sigma), np.zeros(len(sigma))
    rays = _rays_if_kept(at, free, pairs)
    found[free] = _curvature_sigma(np.asarray(at), np.asarray(sigma)[free], free, pairs, width, rays)
    return found


@jax.jit
def _curvature_sigma(
    at: Float[Array, " N"],
    sigma: Float[Array, " V"],
    free: Int[Arrays, " V"],
    pairs: FloorPairs,
    width: float | Float[Array, ""],
    rays: Rays | None,
) -> Float[Array, " V"]:
    def terms(y):
        r, errors, _ = residuals(at.at[free].add(sigma * y), pairs, width, rays)
        return jnp.concatenate([r.reshape(-1), errors.reshape(-1), y])

    jacobian = jax.jacfwd(terms)(jnp.zeros_like(sigma))
    return sigma * jnp.sqrt(jnp.diagonal(jnp.linalg.inv(jacobian.T @ jacobian)))


@jax.jit
def count_agreeing(
    mounts: Float[Arrays, "H 6"], pairs: FloorPairs, limit: float | Float[Array, ""]
) -> Float[Array, " H"]:
    """How many matches coincide at every mount, softly: sum max(1 - r^T r / limit^2, 0), odometry taken as it is.

    The camera is the one that was believed but for its mount.
    """
    rays = rays_of_pixels(pairs.camera, pairs.pixels, pairs.slopes)

    def one(mount):
        r, _ = _residuals(_floor(mount, rays, pairs), pairs.motion)
        return jnp.sum(jnp.maximum(1 - jnp.sum(r * r, 0) / limit**2, 0) * pairs.valid)

    return jax.lax.map(one, jnp.asarray(mounts))
