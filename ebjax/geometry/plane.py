"""The floor from depth: the ground plane by RANSAC, and the camera that it puts over the floor.

Points are in the camera frame (x right, y down, z forward), metres. Jitted.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ebjax.geometry.camera import Camera
from ebjax.geometry.homography import Arrays, Scalar
from ebjax.geometry.ransac import Key, draw_sets

SUBSAMPLE = 2048
ROUNDS = 6


def _upward(normal: Float[Array, "3"], point: Float[Array, "3"]) -> tuple[Float[Array, "4"], Bool[Array, ""]]:
    """The plane through a point, and whether it can be a floor: within 45 degrees of level, below the camera."""
    length = jnp.linalg.norm(normal)
    normal = normal / jnp.where(length > 0, length, jnp.ones_like(length))
    normal = jnp.where(normal[1] > 0, -normal, normal)
    d = -normal @ point
    return jnp.concatenate([normal, d[None]]), (normal[1] < -(0.5**0.5)) & (d > 0)


@partial(jax.jit, static_argnames="hypotheses")
def fit_ground_plane(
    points_camera: Float[Arrays, "N 3"],
    valid: Bool[Arrays, " N"],
    *,
    key: Key,
    hypotheses: int = 1024,
    tolerance_m: Scalar = 0.02,
) -> tuple[Float[Array, "4"], Bool[Array, " N"]]:
    """The floor n . p + d = 0: the plane with the most points, the camera above it, its up within 45 degrees of n.

    RANSAC on 2,048 random points, then least squares in inverse depth over all, sum w (1/Z - a . X/Z)^2, a = -n / d:
    stereo depth has noise ~ Z^2, which is uniform in 1/Z.

    Args:
      points_camera: X in the camera frame, m (`camera.backproject`).
      valid: points with depth.
      key: for the random sets.
      hypotheses: how many planes to try.
      tolerance_m: distance from the plane of an inlier up to 1 m away, and per metre of depth beyond.

    Returns:
      (n, d) with |n| = 1, n up, d the camera's height, m; and the inliers. No floor found: no inliers and d = 0.
    """
    points, valid = jnp.asarray(points_camera), jnp.asarray(valid)
    valid &= jnp.all(jnp.isfinite(points), axis=1) & (points[:, 2] > 0)
    points = jnp.where(valid[:, None], points, 0)
    limit = jnp.asarray(tolerance_m, points.dtype) ** 2
    # Per metre of depth beyond the first: a floor seen obliquely has noise ~ Z across the plane.
    relative = 1 / jnp.maximum(points[:, 2], 1)
    few, sets = jax.random.split(key)
    chosen = draw_sets(valid, few, SUBSAMPLE, 1)[:, 0]
    sample = points[chosen]
    triples = sample[draw_sets(jnp.ones(SUBSAMPLE, bool), sets, hypotheses, 3)]
    normals = jnp.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    planes, possible = jax.vmap(_upward)(normals, triples[:, 0])
    squared = ((planes[:, :3] @ sample.T + planes[:, 3:]) * relative[chosen][None, :]) ** 2
    costs = jnp.where(possible, jnp.minimum(squared, limit).sum(axis=1), jnp.inf)
    first = jnp.argmin(costs)

    inverse_depth = jnp.where(valid, 1 / jnp.where(valid, points[:, 2], 1), 0)
    rays = points * inverse_depth[:, None]

    def refit(_, state):
        plane, cut = state
        squared = ((points @ plane[:3] + plane[3]) * relative) ** 2
        weights = jnp.where(valid & (squared <= cut), (1 - squared / cut) ** 2, 0)
        # Tukey's biweight at five standard deviations keeps the foot of a wall from tilting the floor.
        variance = (weights @ squared) / jnp.maximum(weights.sum(), 1)
        weighted = rays * weights[:, None]
        a = jnp.linalg.solve(weighted.T @ rays, weighted.T @ inverse_depth)
        length = jnp.linalg.norm(a)
        better, floor = _upward(-a, a / jnp.where(length > 0, length, 1) ** 2)
        plane = jnp.where(floor & jnp.all(jnp.isfinite(better)), better, plane)
        return plane, jnp.clip(25 * variance, limit / 100, limit)

    plane, _ = jax.lax.fori_loop(0, ROUNDS, refit, (planes[first], limit))
    found = jnp.isfinite(costs[first]) & (valid.sum() >= 3)
    inliers = valid & found & (((points @ plane[:3] + plane[3]) * relative) ** 2 <= limit)
    return jnp.where(found, plane, jnp.array([0, -1, 0, 0], points.dtype)), inliers


@partial(jax.jit, static_argnames=("width", "height"))
def camera_from_plane(
    plane: Float[Arrays, "4"],
    intrinsics: Float[Arrays, "3 3"],
    width: int,
    height: int,
    x_m: Scalar = 0.0,
    y_m: Scalar = 0.0,
) -> Camera:
    """The camera over the floor n . p + d = 0; base looks along the optical axis (yaw 0).

    A plane does not tell where the camera stands on the robot, nor its yaw. Differentiable.

    Args:
      plane: (n, d) in the camera frame, n up, d the height, m.
      intrinsics: K, px.
      width: image width, px.
      height: image height, px.
      x_m: of the optical centre ahead of the base's origin.
      y_m: of the optical centre to the left of the base's origin.
    """
    p = jnp.asarray(plane)
    up = p[:3] / jnp.linalg.norm(p[:3])
    forward = jnp.array([0, 0, 1], p.dtype) - up[2] * up
    forward = forward / jnp.linalg.norm(forward)
    rotation = jnp.stack([forward, jnp.cross(up, forward), up])
    translation = jnp.stack([jnp.asarray(x_m, p.dtype), jnp.asarray(y_m, p.dtype), p[3]])
    pose = jnp.concatenate([rotation, translation[:, None]], axis=1)
    return Camera(
        jnp.asarray(intrinsics, p.dtype), jnp.concatenate([pose, jnp.array([[0, 0, 0, 1]], p.dtype)]), width, height
    )
