"""The planar motion of a robot between two frames from corners of the whole raw images.

For where the floor view tells nothing: turns on the spot, walls that fill the view, people on the floor. The camera's
mount must be known. All matches are fitted at once, each by what is known of its depth (`planar_motion_cost`): a depth
image, the floor, or nothing but the epipolar line. Host side, NumPy.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ebjax.geometry.camera import Camera
from ebjax.odometry.image_choice import FEWEST, Choice, Images, Kind, choose, known_by
from ebjax.odometry.image_matches import ImageFeatures, match_features
from ebjax.odometry.planar_motion import base_motion, camera_motion, lever
from ebjax.odometry.planar_motion_cost import WRONG_COST, explain
from ebjax.odometry.planar_motion_fit import polish, refine, turn_width

FEWEST_ROTATION = 25
WEAK = 1e-3
"""Information that keeps what no match tells from running away, 1 / m^2 and 1 / rad^2."""
MOST_SIGMA_RAD = 0.01
INFLATION = (1.2, 80.0)
"""The covariance times 1.2 + 80 / inliers: neighbours share their errors, and among few one wrong match tells."""
SHARED_SIGMA = (0.0003, 0.0003, 0.00007)
"""Standard deviation that all matches share: x m, y m, heading rad."""


@dataclass(frozen=True)
class MotionMeasurement:
    """What two images tell of the motion between them.

    Attributes:
      i_from_j: p_i = R(theta) p_j + (x, y) in the frames of the base: x m, y m, theta rad.
      covariance: of i_from_j in its right tangent.
      inliers: matches that the motion explains, those among them that it predicted itself.
      matches: all that the descriptors gave.
      kind: "depth" or "floor" measure all of it; "rotation" only theta: x, y are the prior's length along the epipolar
        direction (0 without a prior), as uncertain as the prior (1 m without).
      ok: False where chance, too few matches or a second motion explains the images as well; use nothing of it then.
    """

    i_from_j: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    inliers: int
    matches: int
    kind: Kind
    ok: bool

    def __repr__(self) -> str:
        """One line."""
        (x, y, theta), sigma = self.i_from_j, np.sqrt(np.diag(self.covariance))
        turn, turn_sigma = np.degrees(theta), np.degrees(sigma[2])
        return (
            f"MotionMeasurement({self.kind}{'' if self.ok else ', not ok'}: "
            f"x {x:.3f} +- {sigma[0]:.3f} m, y {y:.3f} +- {sigma[1]:.3f} m, "
            f"theta {turn:.2f} +- {turn_sigma:.2f} degrees, {self.inliers} of {self.matches} matches)"
        )


def _right_tangent(
    motion: Float[np.ndarray, "3"], covariance: Float[np.ndarray, "3 3"], camera_xy: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "3 3"]:
    """Covariance of (bx, by, theta) -> of the base's motion: R dt = db - R' c dtheta."""
    c, s = np.cos(motion[2]), np.sin(motion[2])
    change = np.eye(3)
    change[:2, 2] = -(lever(motion[2] + np.pi / 2, camera_xy) + camera_xy)
    change[:2] = np.array([[c, s], [-s, c]]) @ change[:2]
    return change @ covariance @ change.T


def _at_length(choice: Choice, expected: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The motion with the length of b that is expected, in its own direction or in that which is expected too."""
    length, moved = np.linalg.norm(expected[:2]), np.linalg.norm(choice.motion[:2])
    starts = expected[None]
    if moved > 0:
        starts = np.stack([np.append(length / moved * choice.motion[:2], choice.motion[2]), expected])
    fit = refine(starts, choice.pairs, 3, floor=False)
    return fit.motions[fit.scores.argmin()]


def measure_motion(
    features_i: ImageFeatures,
    features_j: ImageFeatures,
    camera: Camera,
    prior: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]] | None = None,
) -> MotionMeasurement:
    """Measures i_from_j from two images, up to turns of 70 degrees that leave some of the view in common.

    Args:
      features_i: of the later image, by `image_corners`. Depth counts where both images have it.
      features_j: of the earlier image.
      camera: intrinsics, px, and mount; both images are of this camera.
      prior: (i_from_j, covariance in its right tangent) of wheels or of carried speed. It starts the search, decides
        between motions that both explain the images, and says what a rotation alone cannot: how far. It is not fused.
    """
    rows = match_features(features_i, features_j)
    matches = len(rows[0])
    guess, wide = (np.zeros(3), np.eye(3)) if prior is None else (np.asarray(p, np.float64) for p in prior)
    nothing = MotionMeasurement(guess, wide, 0, matches, "rotation", False)
    if matches < FEWEST:
        return nothing
    if features_i.depth_m is None or features_j.depth_m is None:
        depths = np.zeros(len(features_i)), np.zeros(len(features_j))
    else:
        depths = features_i.depth_m, features_j.depth_m
    images = Images(features_i, features_j, camera, *depths)
    xy = np.asarray(camera.base_from_camera, np.float64)[:2, 3]
    cos, sin = np.cos(guess[2]), np.sin(guess[2])
    turned = np.array([[cos, -sin], [sin, cos]])
    information = np.linalg.inv(wide)

    def distance2(motion: Float[np.ndarray, "3"]) -> float:
        off = base_motion(motion, xy) - guess
        off = np.append(off[:2] @ turned, (off[2] + np.pi) % (2 * np.pi) - np.pi)
        return 0.0 if prior is None else float(off @ information @ off)

    start = camera_motion(guess[None], xy)
    choice = choose(images, rows, start, distance2, floor=True)
    kind: Kind = "rotation" if choice is None else known_by(choice.motion, choice.pairs)
    by_floor = kind != "rotation"
    if not by_floor:
        choice = choose(images, rows, start, distance2, floor=False)
    if choice is None:
        return nothing
    expected = np.append(guess[:2] + lever(choice.motion[2], xy), choice.motion[2])
    motion, weak = choice.motion, WEAK * np.eye(3)
    if not by_floor and prior is not None:
        # How far it went says how much of a sideways shift is turning: what wheels know of x, y steadies theta.
        weak[:2, :2] += INFLATION[0] * turned @ np.linalg.inv(wide[:2, :2]) @ turned.T
        motion = _at_length(choice, expected)
    near = motion if prior is None else expected
    motion, covariance = polish(motion, choice.pairs, near, weak, floor=by_floor)
    inliers = int((explain(motion[None], choice.pairs, floor=by_floor).cost[0] < WRONG_COST).sum())
    covariance = _right_tangent(motion, covariance, xy) * (INFLATION[0] + INFLATION[1] / max(inliers, 1))
    covariance = covariance + np.diag(SHARED_SIGMA) ** 2
    i_from_j = base_motion(motion, xy)
    # A floor that repeats gives two places at one angle: the angle is measured all the same.
    if not by_floor or choice.place_contested:
        kind = "rotation"
        way = motion[:2] / max(np.linalg.norm(motion[:2]), 1e-9)
        moved = expected[:2] if by_floor else np.linalg.norm(expected[:2]) * way
        i_from_j[:2] = 0 if prior is None else moved - lever(motion[2], xy)
        # The width is that of three standard deviations; parallax of a pixel would pass for turning.
        pixel = features_i.unit_px / np.asarray(camera.intrinsics)[0, 0]
        width = 0.0 if by_floor else max(turn_width(motion, choice.pairs) / 3, pixel)
        theta = np.full((1, 1), max(covariance[2, 2], width**2))
        covariance = np.block([[wide[:2, :2], np.zeros((2, 1))], [np.zeros((1, 2)), theta]])
    enough = inliers >= (FEWEST if by_floor else FEWEST_ROTATION)
    ok = enough and not choice.angle_contested and covariance[2, 2] < MOST_SIGMA_RAD**2
    return MotionMeasurement(i_from_j, covariance, inliers, matches, kind, bool(ok))
