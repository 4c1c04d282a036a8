"""The loop measurement i_from_j of SE(2) from matched floor points, and its information from their spread.

Two ways to the points: the metric floor (view pixel -> floor, metres) or depth (raw pixel -> 3D, Early Bird eq.
9-11). Either way a weighted Kabsch gives the motion, and the residuals and the geometry of the inliers give its
covariance:

    Sigma = sigma^2 (sum_k w_k J_k^T J_k)^-1 + Sigma_0,   J_k = [I, (-y_k, x_k)^T]   (right tangent of i_from_j)

with sigma^2 the weighted mean squared residual per axis. Matches of one view share their errors (camera pose, lens),
which no number of inliers averages away: Sigma_0 is that floor.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ebjax.geometry.camera import Camera, backproject, raw_from_ideal
from ebjax.geometry.pytree import pytree
from ebjax.geometry.rigid import kabsch

SHARED_SIGMA = (0.005, 0.005, 0.002)
"""Standard deviation that all inliers share: x m, y m, heading rad."""
MATCHES_PER_PLACE = 4.0
"""Neighbouring matches see the same texture: so many count as one independent observation."""


@pytree
class LoopMeasurement:
    """i_from_j (x m, y m, theta rad), its covariance in the right tangent, and the rms residual of the points, m."""

    i_from_j: Float[Array, "*n 3"]
    covariance: Float[Array, "*n 3 3"]
    residual_m: Float[Array, "*n"]


def _covariance(
    rotation: Float[Array, "2 2"],
    points_j: Float[Array, "M 2"],
    residuals: Float[Array, "M 2"],
    weights: Float[Array, "M"],
) -> tuple[Float[Array, "3 3"], Float[Array, ""]]:
    """Covariance of a planar Kabsch in the right tangent: dp_i = R (dt + [-y_j, x_j] dtheta)."""
    dtype = points_j.dtype
    effective = jnp.maximum(jnp.sum(weights), 1e-6)
    variance = jnp.sum(weights * jnp.sum(residuals**2, 1)) / (2 * effective)
    spin = jnp.stack([-points_j[:, 1], points_j[:, 0]], -1)
    eye = jnp.broadcast_to(jnp.eye(2, dtype=dtype), (points_j.shape[0], 2, 2))
    jacobian = jnp.concatenate([eye, spin[..., None]], -1)
    hessian = jnp.einsum("m,mai,maj->ij", weights, jacobian, jacobian) / MATCHES_PER_PLACE
    # Two points at least are needed for a heading; the ridge keeps fewer finite (and very uncertain).
    spread = jnp.linalg.inv(hessian + 1e-9 * jnp.eye(3, dtype=dtype))
    shared = jnp.diag(jnp.asarray(SHARED_SIGMA, dtype) ** 2)
    # The root of 0 has no derivative, and a NaN of it would spread to all that is differentiated.
    return (variance + 1e-8) * spread + shared, jnp.sqrt(jnp.maximum(2 * variance, 1e-24))


@jax.jit
def measure_floor(
    points_i: Float[Array, "M 2"], points_j: Float[Array, "M 2"], inliers: Bool[Array, "M"] | Float[Array, "M"]
) -> LoopMeasurement:
    """The motion between two metric floor views: p_i = R p_j + t over the inliers, without any depth.

    Differentiable in the points and in weights.

    Args:
      points_i: on the floor, in base_i, m.
      points_j: their partners, in base_j, m.
      inliers: which rows count, or how much, 0 to 1.
    """
    weights = inliers.astype(points_i.dtype)
    rotation, translation = kabsch(points_j, points_i, weights)
    residuals = points_i - (points_j @ rotation.T + translation[None, :])
    covariance, rms = _covariance(rotation, points_j, residuals, weights)
    theta = jnp.arctan2(rotation[1, 0], rotation[0, 0])
    return LoopMeasurement(jnp.concatenate([translation, theta[None]]), covariance, rms)


@jax.jit
def measure_depth(
    points_i: Float[Array, "M 3"], points_j: Float[Array, "M 3"], inliers: Bool[Array, "M"], range_m: Float[Array, "M"]
) -> LoopMeasurement:
    """The motion between two sets of 3D points by weighted Kabsch (Early Bird, eq. 11), projected to the floor.

    Args:
      points_i: in base_i, m.
      points_j: their partners, in base_j, m.
      inliers: which rows count: RANSAC's, with depth in both images.
      range_m: the larger depth of each pair; stereo noise grows with its square, so the weight is range^-4.
    """
    weights = inliers.astype(points_i.dtype) / jnp.maximum(range_m, 0.3) ** 4
    weights = weights * (inliers.sum() / jnp.maximum(weights.sum(), 1e-9))
    rotation, translation = kabsch(points_j, points_i, weights)
    residuals = points_i - (points_j @ rotation.T + translation[None, :])
    theta = jnp.arctan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1])
    planar = jnp.stack([jnp.stack([jnp.cos(theta), -jnp.sin(theta)]), jnp.stack([jnp.sin(theta), jnp.cos(theta)])])
    covariance, rms = _covariance(planar, points_j[:, :2], residuals[:, :2], weights)
    return LoopMeasurement(jnp.concatenate([translation[:2], theta[None]]), covariance, rms)


@partial(jax.jit, static_argnames="radius")
def lift(
    pixels: Float[Array, "K 2"], depth_m: Float[Array, "H W"], camera: Camera, radius: int = 3
) -> tuple[Float[Array, "K 3"], Float[Array, "K"]]:
    """Pixels -> points in base, with the mean of the valid depths around them (Early Bird, eq. 9-10).

    Depth is averaged as its inverse over a (2 radius + 1)^2 window, which is exact on a plane and divides the
    sensor's noise.

    Args:
      pixels: ideal ones, px.
      depth_m: of the raw image, along the optical axis; <= 0 or not finite means missing.
      camera: with base_from_camera.
      radius: of the window, px.

    Returns:
      Points in base, m, and their depth, m: 0 where fewer than a quarter of the window has depth.
    """
    height, width = depth_m.shape
    offset = jnp.arange(-radius, radius + 1, dtype=jnp.int32)
    raw = raw_from_ideal(camera, pixels)
    centre = jnp.round(raw).astype(jnp.int32)
    rows = jnp.clip(centre[:, 1, None] + offset[None, :], 0, height - 1)
    columns = jnp.clip(centre[:, 0, None] + offset[None, :], 0, width - 1)
    window = depth_m[rows[:, :, None], columns[:, None, :]].reshape(len(pixels), -1)
    known = jnp.isfinite(window) & (window > 0)
    share = known.mean(1, dtype=depth_m.dtype)
    inverse = jnp.sum(jnp.where(known, 1 / jnp.where(known, window, 1), 0), 1) / jnp.maximum(known.sum(1), 1)
    inside = (raw[:, 0] >= 0) & (raw[:, 0] <= width - 1) & (raw[:, 1] >= 0) & (raw[:, 1] <= height - 1)
    enough = inside & (share >= 0.25)
    depth = jnp.where(enough, 1 / jnp.where(inverse > 0, inverse, 1), 0)
    points = backproject(pixels, depth, camera.intrinsics)
    pose = jnp.asarray(camera.base_from_camera, points.dtype)
    return points @ pose[:3, :3].T + pose[None, :3, 3], depth
