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
from ebjax.odometry.planar_motion_fit import Fit, polish, refine, search, turn_width

__all__ = ["ImageFeatures", "MotionMeasurement", "image_features", "measure_motion"]

SIGMA_PX = 0.6
LARGE_PX = 10.0
"""Corners larger than this lie less exactly, as their size."""
FEWEST = 10
FEWEST_ROTATION = 20
FEWEST_FLOOR = 8
EVIDENCE = 140.0
"""By how much a motion must explain the matches better than chance: wrong ones reach 120 in aliased images."""
FLOOR_EVIDENCE = 50.0
"""By how much the floor must improve the score: a scale found among hundreds by chance does by 2 log of that, 12."""
GUIDE_BELOW = 80
"""With fewer inliers than this, partners are looked for where the motions predict them."""
HOPEFUL_SHARE = 0.6
"""Motions with less of the best one's evidence cannot win by the partners that they predict."""
RIVAL_SHARE = 0.85
"""A second motion with this share of the evidence makes the first doubtful."""
RIVAL_RAD, RIVAL_M = 0.01, 0.05
PRIOR_CAP = 150.0
"""The most that a prior can cost a motion: it decides between equals and overrules no clear image."""
STILL_M, STILL_RAD, STILL_PX = 0.01, 0.004, 2.0
CELLS = 8
MOST_SIGMA_RAD = 0.01
NARROW_M = 0.05
"""Points of the floor must spread this far (standard deviation) across their line: a skirting board is no floor."""
INFLATION = (1.5, 50.0)
"""The covariance times 1.5 + 50 / inliers: neighbours share their errors, and among few one wrong match tells."""
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
    one, two = np.concatenate([np.stack(rows), np.stack(found)], 1)
    cost = explain(motion[None], images.pairs(one, two), floor=floor).cost[0]
    order = np.argsort(cost, kind="stable")
    order = order[np.sort(np.unique(one[order], return_index=True)[1])]
    order = order[np.sort(np.unique(two[order], return_index=True)[1])]
    pairs = images.pairs(one[order], two[order])
    return refine(motion[None], pairs, 3, floor=floor), pairs


def _floor_gain(motion: Float[np.ndarray, "3"], pairs: Pairs) -> float:
    """By how much the score is better than without a floor; 0 with too few points of the floor."""
    at = explain(motion[None], pairs)
    rows = (at.floor & (at.cost < WRONG_COST))[0]
    points = pairs.rays_j[rows, :2] / pairs.rho_floor[rows, None]
    if rows.sum() < FEWEST_FLOOR or np.linalg.eigvalsh(np.cov(points.T))[0] < NARROW_M**2:
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


def _at_length(choice: "_Choice", expected: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The motion with the length of b that is expected, in its own direction or in that which is expected too."""
    way = choice.motion[:2] / max(np.linalg.norm(choice.motion[:2]), 1e-9)
    starts = np.stack([np.append(np.linalg.norm(expected[:2]) * way, choice.motion[2]), expected])
    fit = refine(starts, choice.pairs, 3, floor=False)
    return fit.motions[fit.scores.argmin()]


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
    evidence = _evidence(fit)
    if evidence[0] < EVIDENCE:
        return None
    motions, sets = fit.motions, [raw] * len(fit.motions)
    if (fit.explained.cost[0] < WRONG_COST).sum() < GUIDE_BELOW:
        hopeful = evidence > HOPEFUL_SHARE * evidence[0]
        evidence = evidence[hopeful]
        guided = [_guide(images, rows, motion, floor) for motion in motions[hopeful]]
        motions, sets = np.concatenate([g.motions for g, _ in guided]), [pairs for _, pairs in guided]
        evidence = evidence + np.concatenate([_evidence(g) for g, _ in guided])
    evidence = evidence - np.minimum([penalty(motion) for motion in motions], PRIOR_CAP)
    best = int(evidence.argmax())
    rivals = evidence > RIVAL_SHARE * evidence[best]
    apart = np.abs(motions - motions[best])
    other_angle = rivals & (apart[:, 2] > RIVAL_RAD)
    other_place = np.flatnonzero(rivals & (apart[:, :2].max(1) > RIVAL_M))
    doubtful = floor and any(_known(motions[k], sets[k]) != "rotation" for k in other_place)
    return _Choice(motions[best], sets[best], bool(other_angle.any()), doubtful)


def _known(motion: Float[np.ndarray, "3"], pairs: Pairs) -> Kind:
    """What tells the length of a motion."""
    right = explain(motion[None], pairs).cost[0] < WRONG_COST
    if (right & pairs.has_depth).sum() >= FEWEST:
        return "depth"
    return "floor" if _floor_gain(motion, pairs) > FLOOR_EVIDENCE else "rotation"


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
    cos, sin = np.cos(guess[2]), np.sin(guess[2])
    turned = np.array([[cos, -sin], [sin, cos]])

    def penalty(motion):
        if prior is None:
            return 0.0
        off = base_motion(motion, xy) - guess
        off = np.append(off[:2] @ turned, (off[2] + np.pi) % (2 * np.pi) - np.pi)
        return off @ information @ off

    start = camera_motion(guess[None], xy)
    choice = _choose(images, rows, start, penalty, True)
    kind: Kind = "rotation"
    if choice is not None and not choice.place_contested:
        kind = _known(choice.motion, choice.pairs)
    measured = kind != "rotation"
    if not measured:
        choice = _choose(images, rows, start, penalty, False)
    if choice is None:
        return nothing
    expected = np.append(guess[:2] + lever(choice.motion[2], xy), choice.motion[2])
    weak = 1e-3 * np.eye(3)
    motion = choice.motion
    if not measured:
        # How far it went says how much of a sideways shift is turning: what wheels know of x, y steadies theta.
        weak[:2, :2] = INFLATION[0] * turned @ np.linalg.inv(wide[:2, :2]) @ turned.T
        motion = _at_length(choice, expected) if prior is not None else motion
    motion, covariance = polish(motion, choice.pairs, expected, weak, floor=measured)
    inliers = int((explain(motion[None], choice.pairs, floor=measured).cost[0] < WRONG_COST).sum())
    covariance = _right_tangent(motion, covariance, xy) * (INFLATION[0] + INFLATION[1] / max(inliers, 1))
    covariance = covariance + np.diag(SHARED_SIGMA) ** 2
    i_from_j = base_motion(motion, xy)
    if not measured:
        way = motion[:2] / max(np.linalg.norm(motion[:2]), 1e-9)
        i_from_j[:2] = 0 if prior is None else np.linalg.norm(expected[:2]) * way - lever(motion[2], xy)
        # The width is that of three standard deviations.
        covariance[2, 2] = max(covariance[2, 2], (turn_width(motion, choice.pairs) / 3) ** 2)
        covariance = np.block([[wide[:2, :2], np.zeros((2, 1))], [np.zeros((1, 2)), covariance[2:, 2:]]])
    ok = (
        inliers >= (FEWEST if measured else FEWEST_ROTATION)
        and not choice.angle_contested
        and covariance[2, 2] < MOST_SIGMA_RAD**2
    )
    return MotionMeasurement(i_from_j, covariance, inliers, matches, kind, bool(ok))
