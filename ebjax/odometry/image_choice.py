"""Which planar motion two images show: candidates from the matches, weighed against chance and against each other.

A motion that other matches contradict is no measurement: floors repeat, doors repeat, people walk, and the robot may
see its own body. Host side, NumPy.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from ebjax.geometry.camera import Camera
from ebjax.odometry.image_guided import guided_matches
from ebjax.odometry.image_matches import ImageFeatures
from ebjax.odometry.planar_motion import Pairs, make_pairs
from ebjax.odometry.planar_motion_cost import WRONG_COST, disparity, explain, score
from ebjax.odometry.planar_motion_fit import SUBSET, Fit, refine, search

SIGMA_PX = 0.6
LARGE_PX = 10.0
"""Corners larger than this lie less exactly, as their size."""
FEWEST = 10
FEWEST_FLOOR = 8
EVIDENCE = 140.0
"""By how much a motion must explain the matches better than chance: wrong ones reach 120 in aliased images."""
FLOOR_EVIDENCE = 50.0
"""By how much the floor must explain its corners better than lines do: a scale found by chance does so by 12."""
NARROW_M = 0.02
"""Points of the floor must spread this far (standard deviation) across their line: a skirting board is no floor."""
GUIDE_BELOW = 80
"""With fewer inliers than this, partners are looked for where the motions predict them."""
HOPEFUL_SHARE = 0.6
"""Motions with less of the best one's evidence cannot win by the partners that they predict."""
RIVAL_SHARE, RIVAL_MARGIN = 0.85, 150.0
"""A second motion with this share of the evidence, and no farther behind, makes the first doubtful."""
RIVAL_RAD, RIVAL_M = 0.01, 0.05
SECOND_SHARE = 0.25
"""A floor that repeats shows a second motion, in matches that the first leaves; with this share it counts."""
PRIOR_GATE = 30.0
"""Squared Mahalanobis distance within which a motion agrees with the prior; the others count if none does."""
STILL_M, STILL_RAD, STILL_PX = 0.01, 0.004, 2.0
PARALLAX_EVIDENCE = 10.0
CELLS = 8

Kind = Literal["depth", "floor", "rotation"]


@dataclass(frozen=True)
class Images:
    """The corners of both images, with the depth at each, m; 0 where it is missing."""

    one: ImageFeatures
    two: ImageFeatures
    camera: Camera
    depth_one: Float[np.ndarray, " N"]
    depth_two: Float[np.ndarray, " M"]

    def pairs(self, rows_i: Int[np.ndarray, " K"], rows_j: Int[np.ndarray, " K"]) -> Pairs:
        """The matches of these rows."""
        size = np.maximum(self.one.sizes_px[rows_i], self.two.sizes_px[rows_j]) / self.one.unit_px
        sigma = SIGMA_PX * self.one.unit_px * np.maximum(1, size / LARGE_PX)
        if self.one.stretch is not None and self.two.stretch is not None:
            sigma = sigma * np.maximum(self.one.stretch[rows_i], self.two.stretch[rows_j])
        pixels = self.one.keypoints[rows_i], self.two.keypoints[rows_j]
        return make_pairs(*pixels, self.camera, sigma, self.depth_one[rows_i], self.depth_two[rows_j])

    def corners_two(self) -> Pairs:
        """The corners of image j, each its own partner."""
        points = self.two.keypoints
        return make_pairs(points, points, self.camera, np.ones(len(points)), self.depth_two, self.depth_two)

    def cells(self, pairs: Pairs) -> int:
        """How many cells of the image have a match."""
        size = max(self.camera.width, self.camera.height) / CELLS
        return len(np.unique(np.floor(pairs.pixels_i / size), axis=0))


@dataclass(frozen=True)
class Choice:
    """The motion that explains the images best, its matches, and whether another does as well, in angle or in place."""

    motion: Float[np.ndarray, "3"]
    pairs: Pairs
    angle_contested: bool
    place_contested: bool


def _evidence(fit: Fit) -> Float[np.ndarray, " C"]:
    """How much better each motion explains the matches than chance."""
    return np.maximum(WRONG_COST - fit.explained.cost, 0).sum(1)


def _stands(motion: Float[np.ndarray, "3"]) -> bool:
    """Whether the camera did not move."""
    return bool(np.abs(motion[:2]).max() < STILL_M and abs(motion[2]) < STILL_RAD)


def _find(images: Images, pairs: Pairs, start: Float[np.ndarray, "K 3"], floor: bool) -> Fit:
    """The best motions; those of the moving matches alone where the others are the robot's own body."""
    fit = search(pairs, start, floor=floor)
    still = np.linalg.norm(pairs.pixels_i - pairs.pixels_j, axis=1) < STILL_PX * images.one.unit_px
    if _stands(fit.motions[0]) and (~still).sum() >= FEWEST:
        moving = pairs.take(~still)
        other = search(moving, start, floor=floor)
        seen = moving.take(other.explained.cost[0] < WRONG_COST)
        if len(seen) >= FEWEST and images.cells(seen) > images.cells(pairs.take(still)):
            return refine(other.motions, pairs, 0, floor=floor)
    return fit


def _second(pairs: Pairs, fit: Fit, start: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "S 3"]:
    """Another motion of the floor among the matches that the best one leaves, if there is one."""
    rest = pairs.take(fit.explained.cost[0] > 2 * WRONG_COST)
    if len(rest) < max(FEWEST, SECOND_SHARE * len(pairs)):
        return np.zeros((0, 3))
    other = search(rest, start)
    if _stands(other.motions[0]):
        return np.zeros((0, 3))
    right = other.explained.cost[0] < WRONG_COST
    known = other.explained.floor[0] | rest.has_depth
    mostly = (right & known).sum() > right.sum() / 2
    enough = _evidence(other)[0] > max(EVIDENCE, SECOND_SHARE * _evidence(fit)[0])
    return other.motions[: int(mostly and enough)]


def _guide(
    images: Images, rows: tuple[Int[np.ndarray, " K"], Int[np.ndarray, " K"]], motion: np.ndarray, floor: bool
) -> tuple[Fit, Pairs]:
    """A motion refined on the matches that it predicts and on the others, each corner in one."""
    found = guided_matches(motion, images.one, images.two, images.corners_two())
    one, two = np.concatenate([np.stack(rows), np.stack(found)], 1)
    cost = explain(motion[None], images.pairs(one, two), floor=floor).cost[0]
    order = np.argsort(cost, kind="stable")
    order = order[np.sort(np.unique(one[order], return_index=True)[1])]
    order = order[np.sort(np.unique(two[order], return_index=True)[1])]
    pairs = images.pairs(one[order], two[order])
    return refine(motion[None], pairs, 3, floor=floor), pairs


def known_by(motion: Float[np.ndarray, "3"], pairs: Pairs) -> Kind:
    """What tells the length of a motion: depth, the floor beyond chance and over an area, or nothing."""
    at = explain(motion[None], pairs)
    right: Bool[np.ndarray, " N"] = at.cost[0] < WRONG_COST
    if (right & pairs.has_depth).sum() >= FEWEST:
        return "depth"
    rows = right & at.floor[0]
    points = pairs.rays_j[rows, :2] / pairs.rho_floor[rows, None]
    if rows.sum() < FEWEST_FLOOR or np.linalg.eigvalsh(np.cov(points.T))[0] < NARROW_M**2:
        return "rotation"
    # A camera that did not move at all moved by nothing, whatever it sees.
    if np.abs(motion[:2]).max() < STILL_M:
        alone = explain(motion[None] * [0, 0, 1], pairs)
        if score(alone.cost)[0] - score(at.cost)[0] < PARALLAX_EVIDENCE:
            return "floor"
    # An epipolar line explains a corner of the floor too, but leaves open how far along it has moved. Where a floor
    # repeats it even explains both motions: only the matches of this one are asked.
    asked = pairs.take(np.flatnonzero(right)[:SUBSET])
    on_floor = rows[right][:SUBSET]
    line = refine(motion[None], asked, 2, floor=False).explained.residuals[:, 0, on_floor]
    spread = at.spread[0, right][:SUBSET][on_floor]
    left_open = 2 * np.log1p(disparity(motion, asked)[on_floor] / spread)
    gain = ((line**2).sum(0) + left_open - at.cost[0, right][:SUBSET][on_floor]).sum()
    return "floor" if gain > FLOOR_EVIDENCE else "rotation"


def _rivals(evidence: Float[np.ndarray, " C"], best: int) -> Bool[np.ndarray, " C"]:
    """Motions with nearly as much evidence as the best one."""
    return evidence > max(RIVAL_SHARE * evidence[best], evidence[best] - RIVAL_MARGIN)


def choose(
    images: Images,
    rows: tuple[Int[np.ndarray, " K"], Int[np.ndarray, " K"]],
    start: Float[np.ndarray, "S 3"],
    distance2: Callable[[Float[np.ndarray, "3"]], float],
    floor: bool,
) -> Choice | None:
    """Searches, looks for more matches where there are few, and weighs the motions that are left.

    Args:
      images: their corners.
      rows: matched rows of both, the surest first.
      start: hypotheses of the caller, (bx, by, theta).
      distance2: squared Mahalanobis distance of a motion from the prior; 0 without one.
      floor: whether matches may be points of the floor.

    Returns:
      None where no motion explains the matches better than chance.
    """
    raw = images.pairs(*rows)
    fit = _find(images, raw, start, floor)
    if _evidence(fit)[0] < EVIDENCE:
        return None
    motions = fit.motions[_evidence(fit) > HOPEFUL_SHARE * _evidence(fit)[0]]
    second = _second(raw, fit, start) if floor else np.zeros((0, 3))
    repeats = np.arange(len(motions) + len(second)) >= len(motions)
    motions = np.concatenate([motions, second])
    found = _evidence(refine(motions, raw, 0, floor=floor))
    sets, total = [raw] * len(motions), found
    if (fit.explained.cost[0] < WRONG_COST).sum() < GUIDE_BELOW:
        guided = [_guide(images, rows, motion, floor) for motion in motions]
        motions, sets = np.concatenate([g.motions for g, _ in guided]), [pairs for _, pairs in guided]
        total = found + np.concatenate([_evidence(g) for g, _ in guided])
    kept = np.array([distance2(motion) < PRIOR_GATE for motion in motions])
    kept &= found > max(EVIDENCE, SECOND_SHARE * found.max())
    kept = np.flatnonzero(kept) if kept.any() else np.arange(len(motions))
    best = int(kept[total[kept].argmax()])
    rivals = _rivals(total, best) | _rivals(found, best) | (repeats != repeats[best])
    rivals &= np.isin(np.arange(len(motions)), kept)
    apart = np.abs(motions - motions[best])
    angle: Bool[np.ndarray, " C"] = rivals & (apart[:, 2] > RIVAL_RAD)
    places = np.flatnonzero(rivals & (apart[:, :2].max(1) > RIVAL_M))
    doubtful = floor and any(repeats[k] or known_by(motions[k], sets[k]) != "rotation" for k in places)
    return Choice(motions[best], sets[best], bool(angle.any()), doubtful)
