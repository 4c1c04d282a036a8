"""The motion i_from_j between two looks at the floor from all of RANSAC's matches, with a covariance that is true.

A point's error grows with how coarsely its floor is imaged: of a point at the distance d from the camera, at height h
over the floor, one image pixel covers (h^2 + d^2) / (h f) metres. Depth errs with the square of the range (stereo).
Either way sigma^2 = VIEW_M^2 + far^2, up to one factor a pair that the residuals tell. Mismatches and edges make the
residuals heavy-tailed: Student's t by reweighting, its factor from the median. The covariance

    Sigma = EXCESS s^2 (sum_k w_k J_k^T J_k / sigma_k^2)^-1,   J_k = R [I, (-y_k, x_k)^T]   (right tangent of i_from_j)

has the strong correlation of y and heading that a patch ahead of the robot implies. Nothing is added that matches
share: what they share is the camera's mount, which the run estimates, and the view's noise, which `EXCESS` counts.
"""

import dataclasses
import typing

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ebjax.features.align import aligned
from ebjax.features.landmarks import Landmarks
from ebjax.features.measure import LoopMeasurement
from ebjax.features.verify import Verified
from ebjax.geometry.camera import Camera, backproject, image_from_floor
from ebjax.geometry.homography import apply
from ebjax.geometry.rigid import kabsch
from ebjax.views.run_view import RunView

VIEW_M = 0.001
"""Standard deviation of a corner in a floor view of 1 cm a pixel, m."""
IMAGE_PX = 0.18
"""... and in the image, px."""
DEPTH_PER_M = 0.001
"""... and of the mean depth around it, m at 1 m; grows with the square of the range."""
FREEDOM = 3.0
"""Degrees of freedom of the residuals' distribution."""
EXCESS = 1.33
"""Neighbouring corners share texture: so much wider than independent ones would say."""
ROUNDS = 10
MEDIAN = 1.3863
"""Of chi-square with two degrees of freedom."""


@typing.no_type_check
@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PairMatches:
    """What a pair's matches are, whatever the mount of the camera: pixels, and points in the camera's frame.

    Attributes:
      pixels_i: in the raw image of frame i, px.
      pixels_j: their partners in that of frame j.
      points_i: the same by depth, in camera_i, m; zero where there is none.
      points_j: likewise.
      matched: which rows are putative matches.
      start: i_from_j that RANSAC found.
    """

    pixels_i: Float[Array, "*n M 2"]
    pixels_j: Float[Array, "*n M 2"]
    points_i: Float[Array, "*n M 3"]
    points_j: Float[Array, "*n M 3"]
    matched: Bool[Array, "*n M"]
    start: Float[Array, "*n 3"]


def pair_matches(ours: Landmarks, theirs: Landmarks, found: Verified, view: RunView, camera: Camera) -> PairMatches:
    """Gathers what a verified pair matched, aligned in the floor views: i is the query, j the reference.

    Args:
      ours: of frame i.
      theirs: of frame j.
      found: their matches and motion on the floor under `camera`.
      view: where the views lie in the image.
      camera: as it is mounted.
    """
    q, r = found.query, found.reference
    motion = found.query_from_reference
    start = jnp.stack([motion[0, 2], motion[1, 2], jnp.arctan2(motion[1, 0], motion[0, 0])])

    def lifted(landmarks, rows):
        return backproject(landmarks.pixels[rows], landmarks.range_m[rows], camera.intrinsics)

    floor_from_view = jnp.linalg.inv(image_from_floor(camera)) @ view.image_from_view
    i_from_j = jnp.linalg.inv(floor_from_view) @ motion @ floor_from_view
    corners = ours.features.keypoints[q].astype(start.dtype)
    others = theirs.features.keypoints[r].astype(start.dtype)
    moved, _ = aligned(ours.grey, theirs.grey, view.seen, i_from_j, corners, others)
    # The floor around a corner is flat: its point by depth moves with it.
    shift = apply(floor_from_view, moved) - apply(floor_from_view, corners)
    shift = shift @ jnp.asarray(camera.base_from_camera)[:2, :3]
    points = lifted(ours, q) + jnp.where(ours.range_m[q][:, None] > 0, shift, 0)
    return PairMatches(
        apply(view.image_from_view, moved), theirs.pixels[r], points, lifted(theirs, r), found.matched, start
    )


def on_floor(pixels: Float[Array, "M 2"], camera: Camera) -> tuple[Float[Array, "M 2"], Float[Array, " M"]]:
    """Floor points in base, m, and the variance of each, m^2, up to a factor."""
    points = apply(jnp.linalg.inv(image_from_floor(camera)), pixels)
    pose, focal = jnp.asarray(camera.base_from_camera), camera.intrinsics[0, 0]
    squared = jnp.sum((points - pose[None, :2, 3]) ** 2, axis=1)
    coarse = (pose[2, 3] ** 2 + squared) / (pose[2, 3] * focal)
    return points, VIEW_M**2 + (IMAGE_PX * coarse) ** 2


def floor_motion(matches: PairMatches, camera: Camera, tolerance_m: float | Float[Array, ""]) -> LoopMeasurement:
    """i_from_j on the metric floor; differentiable in the camera. Matches beyond the tolerance count for nothing."""
    points_i, variance_i = on_floor(matches.pixels_i, camera)
    points_j, variance_j = on_floor(matches.pixels_j, camera)
    return settle(points_i, points_j, variance_i + variance_j, matches.matched, matches.start, tolerance_m)


def depth_motion(
    matches: PairMatches, camera: Camera, tolerance_m: float | Float[Array, ""]
) -> tuple[LoopMeasurement, Bool[Array, " M"]]:
    """i_from_j from points with depth (Early Bird, eq. 9-11), planar; and which matches have depth at both ends."""
    pose = jnp.asarray(camera.base_from_camera)
    deep = matches.matched & (matches.points_i[:, 2] > 0) & (matches.points_j[:, 2] > 0)
    ends = matches.points_i, matches.points_j
    i, j = (points @ pose[:2, :3].T + pose[None, :2, 3] for points in ends)
    # A wrong height scales what RANSAC found on the floor; its inliers say where depth has the same motion.
    (floor_i, _), (floor_j, _) = on_floor(matches.pixels_i, camera), on_floor(matches.pixels_j, camera)
    c, s = jnp.cos(matches.start[2]), jnp.sin(matches.start[2])
    turn = jnp.stack([jnp.stack([c, -s]), jnp.stack([s, c])])
    off = floor_i - (floor_j @ turn.T + matches.start[None, :2])
    near = (deep & (jnp.sum(off**2, axis=1) < jnp.asarray(tolerance_m) ** 2)).astype(i.dtype)
    rotation, shift = kabsch(j, i, near)
    begin = jnp.append(shift, jnp.arctan2(rotation[1, 0], rotation[0, 0]))
    begin = jnp.where(near.sum() >= 3, begin, matches.start)
    variance = sum(VIEW_M**2 + (DEPTH_PER_M * points[:, 2] ** 2) ** 2 for points in ends)
    return settle(i, j, jnp.asarray(variance), deep, begin, tolerance_m), deep


def settle(
    points_i: Float[Array, "M 2"],
    points_j: Float[Array, "M 2"],
    variance: Float[Array, " M"],
    matched: Bool[Array, " M"],
    start: Float[Array, "3"],
    tolerance_m: float | Float[Array, ""],
) -> LoopMeasurement:
    """Reweighted least squares on p_i = R p_j + t from a start that is right to about the tolerance."""
    dtype = points_i.dtype
    limit = jnp.asarray(tolerance_m, dtype) ** 2
    ridge = 1e-6 * jnp.eye(3, dtype=dtype)

    def system(motion):
        c, s = jnp.cos(motion[2]), jnp.sin(motion[2])
        turn = jnp.stack([jnp.stack([c, -s]), jnp.stack([s, c])])
        residual = points_i - (points_j @ turn.T + motion[None, :2])
        squared = jnp.sum(residual**2, axis=1)
        near = matched & (squared < limit)
        relative = squared / variance
        ranked = jnp.sort(jnp.where(near, relative, jnp.inf))
        count = near.sum()
        middle = jnp.where(count > 0, ranked[jnp.maximum(count // 2, 0)], 1.0)
        factor = jnp.maximum(middle / MEDIAN, 0.05)
        weight = jnp.where(near, (FREEDOM + 2) / ((FREEDOM + relative / factor) * variance * factor), 0)
        spin = jnp.stack([-points_j[:, 1], points_j[:, 0]], -1) @ turn.T
        columns = jnp.broadcast_to(turn.T[None], (*squared.shape, 2, 2))
        jacobian = jnp.concatenate([columns, spin[:, None, :]], axis=1)  # M x (3 unknowns) x 2
        hessian = jnp.einsum("m,mia,mja->ij", weight, jacobian, jacobian)
        gradient = jnp.einsum("m,mia,ma->i", weight, jacobian, residual)
        return turn, hessian, gradient, jnp.sqrt(jnp.sum(weight * squared) / jnp.maximum(jnp.sum(weight), 1e-12))

    def step(motion, _):
        turn, hessian, gradient, _ = system(motion)
        delta = jnp.linalg.solve(hessian + ridge, gradient)
        return jnp.concatenate([motion[:2] + turn @ delta[:2], motion[2:] + delta[2:]]), None

    motion, _ = jax.lax.scan(step, start.astype(dtype), None, length=ROUNDS)
    _, hessian, _, rms = system(motion)
    return LoopMeasurement(motion, EXCESS * jnp.linalg.inv(hessian + ridge), rms)
