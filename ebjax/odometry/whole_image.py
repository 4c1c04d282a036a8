"""The planar motion of a robot between two frames from corners of the whole raw images.

For where the floor view tells nothing: turns on the spot, walls that fill the view, people on the floor. The camera's
mount must be known. All matches are fitted at once, each by what is known of its depth (`planar_motion_cost`): a depth
image, the floor, or nothing but the epipolar line. Host side, NumPy.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from ebjax.features.measure import lift
from ebjax.geometry.camera import Camera
from ebjax.odometry.image_guided import guided_matches
from ebjax.odometry.image_matches import COUNT, ImageFeatures, image_features, match_features
from ebjax.odometry.planar_motion import Pairs, base_motion, camera_motion, lever, make_pairs
from ebjax.odometry.planar_motion_cost import WRONG_COST, explain, score
from ebjax.odometry.planar_motion_fit import Fit, polish, refine, search

__all__ = ["ImageFeatures", "MotionMeasurement", "image_features", "measure_motion"]

SIGMA_PX = 0.6
LARGE_PX = 10.0
"""Corners larger than this lie less exactly, as their size."""
FEWEST = 10
FEWEST_FLOOR = 6
EVIDENCE = 120.0
"""By how much a motion must explain the matches better than chance: wrong ones reach 110 in aliased images."""
FLOOR_EVIDENCE = 30.0
"""By how much the floor must improve the score: a scale found among hundreds by chance does by 2 log of that, 12."""
GUIDE_BELOW = 80
"""With fewer inliers than this, partners are looked for where the motions predict them."""
RIVAL_SHARE = 0.85
"""A second motion with this share of the evidence makes the first doubtful."""
RIVAL_RAD, RIVAL_M = 0.01, 0.05
PRIOR_CAP = 150.0
"""The most that a prior can cost a motion: it decides between equals and overrules no clear image."""
STILL_M, STILL_RAD, STILL_PX = 0.01, 0.004, 2.0
CELLS = 8
MOST_SIGMA_RAD = 0.01
PARALLAX_EVIDENCE = 15.0
INFLATION = 2.0
"""Factor of the covariance: matches of one image share their errors."""
SHARED_SIGMA = (0.0005, 0.0005, 0.0001)
"""Standard deviation that all matches share: x m, y m, heading rad."""

Kind = Literal["depth", "floor", "rotation"]


@dataclass(frozen=True)
class MotionMeasurement:
    """What two images tell of the motion between them.

    Attributes:
      i_from_j: p_i = R(theta) p_j + (x, y) in the frames of the base: x m, y m, theta rad.
      covariance: of i_from_j in its right tangent.
      inliers: matches that the motion explains.
      matches: all matches.
      kind: "depth" or "floor" measure all of it; "rotation" only theta: x, y are the prior's as far as the epipolar
        direction allows, and as uncertain as the prior.
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


def _depths(features: ImageFeatures, depth_m: Float[np.ndarray, "H W"], camera: Camera) -> Float[np.ndarray, " N"]:
    """Depth at every corner, m, 0 where missing; padded so that one program serves all images."""
    padded = np.zeros((-(-max(len(features), 1) // COUNT) * COUNT, 2), np.float32)
    padded[: len(features)] = features.keypoints
    return np.asarray(lift(padded, np.asarray(depth_m, np.float32), camera)[1], np.float64)[: len(features)]


@dataclass(frozen=True)
class _Images:
    """Both images' corners, with depth at each, 0 where missing or not given."""

    one: ImageFeatures
    two: ImageFeatures
    camera: Camera
    depth_one: Float[np.ndarray, " N"]
    depth_two: Float[np.ndarray, " M"]

    def pairs(self, rows_i: np.ndarray, rows_j: np.ndarray) -> Pairs:
        """The matches of these rows."""
        size = np.maximum(self.one.sizes_px[rows_i], self.two.sizes_px[rows_j]) / self.one.unit_px
        sigma = SIGMA_PX * self.one.unit_px * np.maximum(1, size / LARGE_PX)
        pixels = self.one.keypoints[rows_i], self.two.keypoints[rows_j]
        return make_pairs(*pixels, self.camera, sigma, self.depth_one[rows_i], self.depth_two[rows_j])

    def corners_two(self) -> Pairs:
        """The corners of image j, each its own partner."""
        ones, points = np.ones(len(self.two)), self.two.keypoints
        return make_pairs(points, points, self.camera, ones, self.depth_two, self.depth_two)

    def cells(self, pairs: Pairs) -> int:
        """How many cells of the image have a match."""
        size = max(self.camera.width, self.camera.height) / CELLS
        return len(np.unique(np.floor(pairs.pixels_i / size), axis=0))


def _evidence(fit: Fit) -> Float[np.ndarray, " C"]:
    """How much better each motion explains the matches than chance."""
    return np.maximum(WRONG_COST - fit.explained.cost, 0).sum(1)


def _find(images: _Images, pairs: Pairs, start: Float[np.ndarray, "K 3"], floor: bool) -> Fit:
    """The best motions; those of the moving matches alone where the others are the robot's own body."""
    fit = search(pairs, start, floor=floor)
    still = np.linalg.norm(pairs.pixels_i - pairs.pixels_j, axis=1) < STILL_PX * images.one.unit_px
    bx, by, theta = np.abs(fit.motions[0])
    stands = max(bx, by) < STILL_M and theta < STILL_RAD
    if stands and (~still).sum() >= FEWEST:
        moving = pairs.take(~still)
        other = search(moving, start, floor=floor)
        seen = moving.take(other.explained.cost[0] < WRONG_COST)
        if len(seen) >= FEWEST and images.cells(seen) > images.cells(pairs.take(still)):
            return refine(other.motions, pairs, 0, floor=floor)
    return fit


def _guide(images: _Images, rows: tuple[np.ndarray, np.ndarray], motion: np.ndarray, floor: bool) -> tuple[Fit, Pairs]:
    """A motion refined on the matches that it predicts, besides those that it explains."""
    found = guided_matches(motion, images.one, images.two, images.corners_two())
    both = np.unique(np.concatenate([np.stack(rows), np.stack(found)], 1), axis=1)
    pairs = images.pairs(*both)
    pairs = pairs.take(explain(motion[None], pairs, floor=floor).cost[0] < 3 * WRONG_COST)
    return refine(motion[None], pairs, 4, floor=floor), pairs


def _floor_gain(motion: Float[np.ndarray, "3"], pairs: Pairs) -> float:
    """By how much the score is better than without a floor; 0 with too few points of the floor."""
    at = explain(motion[None], pairs)
    if (at.floor & (at.cost < WRONG_COST)).sum() < FEWEST_FLOOR:
        return 0.0
    return float(refine(motion[None], pairs, 4, floor=False).scores[0] - score(at.cost)[0])


def _right_tangent(
    motion: Float[np.ndarray, "3"], covariance: Float[np.ndarray, "3 3"], camera_xy: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "3 3"]:
    """Covariance of (bx, by, theta) -> of the base's motion: R dt = db - R' c dtheta."""
    c, s = np.cos(motion[2]), np.sin(motion[2])
    change = np.eye(3)
    change[:2, 2] = -(lever(motion[2] + np.pi / 2, camera_xy) + camera_xy)
    change[:2] = np.array([[c, s], [-s, c]]) @ change[:2]
    return change @ covariance @ change.T


def _carried(
    motion: Float[np.ndarray, "3"], pairs: Pairs, guess: Float[np.ndarray, "3"], xy: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "2"]:
    """(x, y) with the prior's length of b and the epipolar direction; the prior's own where there is no parallax."""
    moved = guess[:2] + lever(guess[2], xy)
    alone = refine(np.array([[0.0, 0.0, motion[2]]]), pairs, 3, floor=False)
    alone = explain(alone.motions * [0, 0, 1], pairs, floor=False)
    gain = score(alone.cost)[0] - score(explain(motion[None], pairs, floor=False).cost)[0]
    if gain < PARALLAX_EVIDENCE:
        return moved - lever(motion[2], xy)
    way = motion[:2] / max(np.linalg.norm(motion[:2]), 1e-9)
    return np.linalg.norm(moved) * way - lever(motion[2], xy)


@dataclass(frozen=True)
class _Choice:
    """The motion that explains the images best, its matches, and whether another does as well, in angle or in place."""

    motion: Float[np.ndarray, "3"]
    pairs: Pairs
    angle_contested: bool
    place_contested: bool


def _choose(images: _Images, rows, start: np.ndarray, penalty, floor: bool) -> _Choice | None:
    """Searches, looks for more matches where there are few, and weighs the motions that are left."""
    raw = images.pairs(*rows)
    fit = _find(images, raw, start, floor)
    if _evidence(fit)[0] < EVIDENCE:
        return None
    if (fit.explained.cost[0] < WRONG_COST).sum() >= GUIDE_BELOW:
        fits, sets = fit, [raw] * len(fit.motions)
    else:
        guided = [_guide(images, rows, motion, floor) for motion in fit.motions]
        fits, sets = None, [pairs for _, pairs in guided]
    motions = fits.motions if fits else np.concatenate([g.motions for g, _ in guided])
    evidence = _evidence(fits) if fits else np.concatenate([_evidence(g) for g, _ in guided])
    evidence = evidence - np.minimum([penalty(motion) for motion in motions], PRIOR_CAP)
    best = int(evidence.argmax())
    rivals = evidence > RIVAL_SHARE * evidence[best]
    apart = np.abs(motions - motions[best])
    other_angle = rivals & (apart[:, 2] > RIVAL_RAD)
    other_place = rivals & (apart[:, :2].max(1) > RIVAL_M)
    doubtful = floor and any(_floor_gain(motions[k], sets[k]) > FLOOR_EVIDENCE for k in np.flatnonzero(other_place))
    return _Choice(motions[best], sets[best], bool(other_angle.any()), doubtful)


def measure_motion(
    features_i: ImageFeatures,
    features_j: ImageFeatures,
    camera: Camera,
    depth_i: Float[np.ndarray, "H W"] | None = None,
    depth_j: Float[np.ndarray, "H W"] | None = None,
    prior: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]] | None = None,
) -> MotionMeasurement:
    """Measures i_from_j from two images, up to turns of 70 degrees that leave some of the view in common.

    Args:
      features_i: of the later image, by `image_features`.
      features_j: of the earlier image.
      camera: intrinsics, px, and mount; both images are of this camera.
      depth_i: of image i, m; 0 or not finite where missing.
      depth_j: of image j.
      prior: (i_from_j, covariance in its right tangent) of wheels or of carried speed. It starts the search, decides
        between motions that explain the images equally well, and says what a rotation alone cannot: how far. It is
        not fused.
    """
    guess, wide = (np.zeros(3), np.eye(3)) if prior is None else (np.asarray(p, np.float64) for p in prior)
    rows = match_features(features_i, features_j)
    matches = len(rows[0])
    nothing = MotionMeasurement(guess, wide, 0, matches, "rotation", False)
    if matches < FEWEST:
        return nothing
    depths = [np.zeros(len(f)) for f in (features_i, features_j)]
    if depth_i is not None and depth_j is not None:
        depths = [_depths(f, d, camera) for f, d in ((features_i, depth_i), (features_j, depth_j))]
    images = _Images(features_i, features_j, camera, *depths)
    xy = np.asarray(camera.base_from_camera, np.float64)[:2, 3]
    information = np.linalg.inv(wide)

    def penalty(motion):
        if prior is None:
            return 0.0
        off = base_motion(motion, xy) - guess
        c, s = np.cos(guess[2]), np.sin(guess[2])
        off = np.array([c * off[0] + s * off[1], c * off[1] - s * off[0], (off[2] + np.pi) % (2 * np.pi) - np.pi])
        return off @ information @ off

    start = camera_motion(guess[None], xy)
    choice = _choose(images, rows, start, penalty, True)
    if choice is None:
        return nothing
    right = explain(choice.motion[None], choice.pairs).cost[0] < WRONG_COST
    kind: Kind = "rotation"
    if (right & ~np.isnan(choice.pairs.rho_j)).sum() >= FEWEST:
        kind = "depth"
    elif not choice.place_contested and _floor_gain(choice.motion, choice.pairs) > FLOOR_EVIDENCE:
        kind = "floor"
    else:
        choice = _choose(images, rows, start, penalty, False)
        if choice is None:
            return nothing
    measured = kind != "rotation"
    weak = np.diag([1e-3, 1e-3, 1e-3] if measured else [4.0, 4.0, 1e-3])
    motion, covariance, at = polish(choice.motion, choice.pairs, weak, floor=measured)
    inliers = int((at.cost[0] < WRONG_COST).sum())
    covariance = INFLATION * _right_tangent(motion, covariance, xy) + np.diag(SHARED_SIGMA) ** 2
    i_from_j = base_motion(motion, xy)
    if not measured:
        i_from_j[:2] = _carried(motion, choice.pairs, guess, xy) if prior is not None else 0
        covariance = np.block([[wide[:2, :2], np.zeros((2, 1))], [np.zeros((1, 2)), covariance[2:, 2:]]])
    ok = inliers >= FEWEST and not choice.angle_contested and covariance[2, 2] < MOST_SIGMA_RAD**2
    return MotionMeasurement(i_from_j, covariance, inliers, matches, kind, bool(ok))
