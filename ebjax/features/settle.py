"""The motion i_from_j between two looks at the floor from all of RANSAC's matches, with a covariance that is true.

What a match tells of the floor is a patch of the view (`align`): little along an edge or the grain of wood, and less
where one image pixel covers much floor. Depth errs with the square of the range (stereo). Either way that is a
covariance S_k of each match, up to one factor a pair that the residuals tell. Mismatches make the residuals
heavy-tailed: Student's t by reweighting, its factor from the median. The covariance

    Sigma = EXCESS s^2 (sum_k w_k J_k^T S_k^-1 J_k)^-1,   J_k = R [I, (-y_k, x_k)^T]   (right tangent of i_from_j)

has the strong correlation of y and heading that a patch ahead of the robot implies. Nothing is added that matches
share: what they share is the camera's mount, which the run estimates, and the view's noise, which `EXCESS` counts.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ebjax.features.align import aligned
from ebjax.features.landmarks import Landmarks
from ebjax.features.measure import LoopMeasurement
from ebjax.features.verify import Verified
from ebjax.geometry.camera import Camera, backproject, image_from_floor, raw_slopes
from ebjax.geometry.homography import apply, slopes
from ebjax.geometry.pytree import pytree
from ebjax.geometry.rigid import kabsch
from ebjax.views.run_view import RunView

VIEW_M = 0.001
"""Standard deviation of a point in a floor view of 1 cm a pixel, m."""
DEPTH_PER_M = 0.001
"""... and of the mean depth around it, m at 1 m; grows with the square of the range."""
FREEDOM = 3.0
"""Degrees of freedom of the residuals' distribution."""
EXCESS = 2.5
"""Neighbouring patches share texture: so much wider than independent ones would say."""
LEAST_FACTOR = 0.02
"""No pair is more certain than that: of the variances that `spread` says."""
ROUNDS, STEPS = 4, 2
"""The factor is taken anew each round, the motion at each step of a round."""
MEDIAN = 1.3863
"""Of chi-square with two degrees of freedom."""


@pytree
class PairMatches:
    """What a pair's matches are, whatever the mount of the camera: pixels, and points in the camera's frame.

    Attributes:
      pixels_i: ideal ones of image i, px.
      pixels_j: their partners in that of frame j.
      points_i: the same by depth, in camera_i, m; zero where there is none.
      points_j: likewise.
      matched: which rows are putative matches.
      start: i_from_j that RANSAC found.
      spread: covariance of pixels_i as partners of pixels_j, px^2, up to a factor a pair.
    """

    pixels_i: Float[Array, "*n M 2"]
    pixels_j: Float[Array, "*n M 2"]
    points_i: Float[Array, "*n M 3"]
    points_j: Float[Array, "*n M 3"]
    matched: Bool[Array, "*n M"]
    start: Float[Array, "*n 3"]
    spread: Float[Array, "*n M 2 2"]


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
    keypoints = ours.features.keypoints[q].astype(start.dtype)
    others = theirs.features.keypoints[r].astype(start.dtype)
    moved, covariance, _ = aligned(ours.grey, theirs.grey, view.seen, i_from_j, keypoints, others)
    # The floor around a keypoint is flat: its point by depth moves with it.
    shift = apply(floor_from_view, moved) - apply(floor_from_view, keypoints)
    shift = shift @ jnp.asarray(camera.base_from_camera)[:2, :3]
    points = lifted(ours, q) + jnp.where(ours.range_m[q][:, None] > 0, shift, 0)
    along = slopes(view.image_from_view, moved)
    pixels = apply(view.image_from_view, moved)
    # Where an image pixel covers many of the view's, the view's noise is as coarse as they are.
    coarse = 1 + jnp.sum(jnp.linalg.inv(raw_slopes(camera, pixels) @ along) ** 2, (1, 2))
    spread = coarse[:, None, None] * (along @ covariance @ jnp.swapaxes(along, 1, 2))
    return PairMatches(pixels, theirs.pixels[r], points, lifted(theirs, r), found.matched, start, spread)


def on_floor(pixels: Float[Array, "M 2"], camera: Camera) -> Float[Array, "M 2"]:
    """Where ideal pixels of the image lie on the floor in base, m."""
    return apply(jnp.linalg.inv(image_from_floor(camera)), pixels)


def spread_on_floor(
    matches: PairMatches, camera: Camera
) -> tuple[Float[Array, "M 2"], Float[Array, "M 2"], Float[Array, "M 2 2"]]:
    """Floor points in base_i and base_j, m, and the covariance of the first as partners of the second, m^2."""
    floor_from_image = jnp.linalg.inv(image_from_floor(camera))
    points_i, points_j = (apply(floor_from_image, pixels) for pixels in (matches.pixels_i, matches.pixels_j))
    along = slopes(floor_from_image, matches.pixels_i)
    return points_i, points_j, along @ matches.spread @ jnp.swapaxes(along, 1, 2)


def white(vectors: Float[Array, "... 2"], spread: Float[Array, "... 2 2"]) -> Float[Array, "... 2"]:
    """L^-1 v, where L L^T is the spread; broadcasts."""
    first = jnp.sqrt(spread[..., 0, 0])
    slant = spread[..., 1, 0] / first
    second = jnp.sqrt(spread[..., 1, 1] - slant**2)
    x = vectors[..., 0] / first
    return jnp.stack([x, (vectors[..., 1] - slant * x) / second], -1)


def floor_motion(matches: PairMatches, camera: Camera, tolerance_m: float | Float[Array, ""]) -> LoopMeasurement:
    """i_from_j on the metric floor; differentiable in the camera. Matches beyond the tolerance count for nothing."""
    points_i, points_j, spread = spread_on_floor(matches, camera)
    return settle(points_i, points_j, spread, matches.matched, matches.start, tolerance_m)


def depth_motion(
    matches: PairMatches, camera: Camera, tolerance_m: float | Float[Array, ""]
) -> tuple[LoopMeasurement, Bool[Array, " M"]]:
    """i_from_j from points with depth (Early Bird, eq. 9-11), planar; and which matches have depth at both ends."""
    pose = jnp.asarray(camera.base_from_camera)
    deep = matches.matched & (matches.points_i[:, 2] > 0) & (matches.points_j[:, 2] > 0)
    ends = matches.points_i, matches.points_j
    i, j = (points @ pose[:2, :3].T + pose[None, :2, 3] for points in ends)
    # A wrong height scales what RANSAC found on the floor; its inliers say where depth has the same motion.
    floor_i, floor_j = on_floor(matches.pixels_i, camera), on_floor(matches.pixels_j, camera)
    c, s = jnp.cos(matches.start[2]), jnp.sin(matches.start[2])
    turn = jnp.stack([jnp.stack([c, -s]), jnp.stack([s, c])])
    off = floor_i - (floor_j @ turn.T + matches.start[None, :2])
    near = (deep & (jnp.sum(off**2, axis=1) < jnp.asarray(tolerance_m) ** 2)).astype(i.dtype)
    rotation, shift = kabsch(j, i, near)
    begin = jnp.append(shift, jnp.arctan2(rotation[1, 0], rotation[0, 0]))
    begin = jnp.where(near.sum() >= 3, begin, matches.start)
    variance = sum(VIEW_M**2 + (DEPTH_PER_M * points[:, 2] ** 2) ** 2 for points in ends)
    spread = jnp.asarray(variance)[:, None, None] * jnp.eye(2, dtype=i.dtype)[None]
    return settle(i, j, spread, deep, begin, tolerance_m), deep


def settle(
    points_i: Float[Array, "M 2"],
    points_j: Float[Array, "M 2"],
    spread: Float[Array, "M 2 2"],
    matched: Bool[Array, " M"],
    start: Float[Array, "3"],
    tolerance_m: float | Float[Array, ""],
) -> LoopMeasurement:
    """Reweighted least squares on p_i = R p_j + t from a start that is right to about the tolerance.

    Args:
      points_i: floor points in base_i, m.
      points_j: their partners in base_j, m.
      spread: covariance of p_i - R p_j - t, m^2, up to one factor.
      matched: which rows count.
      start: i_from_j.
      tolerance_m: matches beyond count for nothing.
    """
    dtype = points_i.dtype
    limit = jnp.asarray(tolerance_m, dtype) ** 2
    ridge = 1e-6 * jnp.eye(3, dtype=dtype)

    def residuals(motion):
        """The turn, residuals as they are and whitened, and which matches are near."""
        c, s = jnp.cos(motion[2]), jnp.sin(motion[2])
        turn = jnp.stack([jnp.stack([c, -s]), jnp.stack([s, c])])
        plain = points_i - (points_j @ turn.T + motion[None, :2])
        return turn, plain, white(plain, spread), matched & (jnp.sum(plain**2, axis=1) < limit)

    def factor(motion):
        """Of the spread, from the median of the residuals."""
        _, _, whitened, near = residuals(motion)
        ranked = jnp.sort(jnp.where(near, jnp.sum(whitened**2, axis=1), jnp.inf))
        count = near.sum()
        return jnp.maximum(jnp.where(count > 0, ranked[count // 2], 1.0) / MEDIAN, LEAST_FACTOR)

    def system(motion, variance):
        turn, plain, whitened, near = residuals(motion)
        relative = jnp.sum(whitened**2, axis=1) / variance
        weight = jnp.where(near, (FREEDOM + 2) / ((FREEDOM + relative) * variance), 0)
        spin = jnp.stack([-points_j[:, 1], points_j[:, 0]], -1) @ turn.T
        columns = jnp.broadcast_to(turn.T[None], (len(spin), 2, 2))
        jacobian = jnp.concatenate([columns, spin[:, None, :]], axis=1)  # M x (3 unknowns) x 2
        jacobian = white(jacobian, spread[:, None])
        hessian = jnp.einsum("m,mia,mja->ij", weight, jacobian, jacobian)
        gradient = jnp.einsum("m,mia,ma->i", weight, jacobian, whitened)
        squared = jnp.sum(weight[:, None] * plain**2)
        return turn, hessian, gradient, jnp.sqrt(squared / jnp.maximum(jnp.sum(weight), 1e-12))

    def step(motion, _):
        variance = factor(motion)
        for _ in range(STEPS):
            turn, hessian, gradient, _ = system(motion, variance)
            delta = jnp.linalg.solve(hessian + ridge, gradient)
            motion = jnp.concatenate([motion[:2] + turn @ delta[:2], motion[2:] + delta[2:]])
        return motion, None

    motion, _ = jax.lax.scan(step, start.astype(dtype), None, length=ROUNDS)
    _, hessian, _, rms = system(motion, factor(motion))
    return LoopMeasurement(motion, EXCESS * jnp.linalg.inv(hessian + ridge), rms)
