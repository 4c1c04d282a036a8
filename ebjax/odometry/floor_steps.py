"""Steps measured on the floor or by depth, the camera's tilt put right by them first."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from ebjax.features.settle import PairMatches
from ebjax.features.verify_pairs import Settled, settle_all
from ebjax.geometry.camera import Camera
from ebjax.geometry.planar import between, compose, inverse, log
from ebjax.odometry.chain import LIMIT
from ebjax.odometry.height import SLIP_M_PER_RAD
from ebjax.odometry.mount import Tilt, refine_tilt
from ebjax.odometry.partners import partners
from ebjax.odometry.steps import MIN_INLIERS, MIN_RATIO, Steps, judged
from ebjax.odometry.wheels import WheelErrors
from ebjax.views.run_view import RunView

MIN_DEPTH = 8
STILL_M, STILL_RAD = 0.01, 0.005
SAME_PICTURE = 0.35
"""Two views of a floor that did not move differ by less than this share of what views differ by a step apart."""
NOT_THE_FLOOR = "the matches stand still while the robot moves"
NOT_THE_WHEELS = "the whole image contradicts the wheels"


@dataclasses.dataclass(frozen=True)
class FloorPairs:
    """Verified pairs of keyframes, rows i > j.

    Attributes:
      i: rows of the later keyframes.
      j: rows of the earlier ones.
      inliers: agreeing matches.
      total: putative ones.
      matches: of some of the pairs, by their place in `i`.
      settled: their motions under the camera they were verified with; None where that is another by now.
    """

    i: Int[np.ndarray, " K"]
    j: Int[np.ndarray, " K"]
    inliers: Int[np.ndarray, " K"]
    total: Int[np.ndarray, " K"]
    matches: Callable[[Int[np.ndarray, " n"]], PairMatches]
    settled: Settled | None = None

    @property
    def believed(self) -> Bool[np.ndarray, " K"]:
        """Those whose matches agree well enough."""
        return (self.inliers >= MIN_INLIERS) & (self.inliers >= MIN_RATIO * self.total)

    def measured(
        self, camera: Camera, tolerance_m: float, trust_depth: bool = False
    ) -> tuple[Float[np.ndarray, "K 3"], Float[np.ndarray, "K 3 3"], Bool[np.ndarray, " K"]]:
        """i_from_j and its covariance by floor or depth, whichever is more certain, and which it was."""
        settled = self.settled
        if settled is None:
            settled = settle_all(self.matches, len(self.i), camera, tolerance_m)
        return more_certain(settled, trust_depth)


PairsUnder = Callable[[Camera, Int[np.ndarray, " K"], Int[np.ndarray, " K"]], FloorPairs]
"""(camera, rows of the later keyframes, of the earlier ones) -> the pairs, verified under that camera."""


def upright_pairs(
    pairs_under: PairsUnder,
    view: RunView,
    camera: Camera,
    poses: Float[np.ndarray, "N 3"],
    *,
    tolerance_m: float,
    refine: bool,
) -> tuple[FloorPairs, Camera, Tilt]:
    """Verifies every keyframe against earlier ones, the camera's tilt put right by the first pairs."""
    i, j = partners(view, poses)
    tilt = Tilt()
    pairs = pairs_under(camera, i, j)
    for _ in range(2 if refine else 0):
        camera, more = refine_tilt(pairs.matches, pairs.believed, camera, tolerance_m)
        tilt = tilt.further(more)
        if not more.applied:
            break
        pairs = pairs_under(camera, i, j)
    return pairs, camera, tilt


def table_of(pairs: FloorPairs, camera: Camera, tolerance_m: float, trust_depth: bool = False) -> Steps:
    """Verified pairs as steps, measured by the floor or by depth, whichever is more certain."""
    i_from_j, covariance, by_depth = pairs.measured(camera, tolerance_m, trust_depth)
    kind = np.where(by_depth, "depth", "floor").astype(object)
    return judged(pairs.i, pairs.j, kind, pairs.inliers, pairs.total, i_from_j, covariance)


def more_certain(
    settled: Settled, trust_depth: bool
) -> tuple[Float[np.ndarray, "K 3"], Float[np.ndarray, "K 3 3"], Bool[np.ndarray, " K"]]:
    """i_from_j and its covariance by floor or depth, and which it was; depth wherever there is any if it is trusted."""
    floor, depth = settled.floor, settled.depth
    size = [np.trace(m.covariance[:, :2, :2], axis1=1, axis2=2) for m in (floor, depth)]
    by_depth = (settled.with_depth >= MIN_DEPTH) & (trust_depth | (size[1] < size[0]))
    return (
        np.where(by_depth[:, None], depth.i_from_j, floor.i_from_j).astype(float),
        np.where(by_depth[:, None, None], depth.covariance, floor.covariance).astype(float),
        by_depth,
    )


def without_body(
    steps: Steps, wheels: Float[np.ndarray, "N 3"], views: Sequence[UInt8[np.ndarray, "h w 3"]], errors: WheelErrors
) -> Steps:
    """Refuses steps of no motion where the wheels turned and the views, as a whole, did change or are one and the same.

    Matches that stand still while the robot moves lie on the robot itself, or the camera has frozen.
    """
    still = steps.used & (np.hypot(*steps.i_from_j[:, :2].T) < STILL_M) & (np.abs(steps.i_from_j[:, 2]) < STILL_RAD)
    counted = between(wheels[steps.i], wheels[steps.j])
    moved, turned = np.hypot(*counted[:, :2].T), np.abs(counted[:, 2])
    far = moved > np.maximum(4 * (errors.translation * moved + 0.005), 3 * STILL_M)
    rows = np.flatnonzero(still & (far | (turned > np.maximum(4 * errors.turning * turned, 6 * STILL_RAD))))
    if not len(rows):
        return steps

    def change(a, b):
        return float(np.abs(views[a].astype(np.int16) - views[b]).mean())

    usual = np.median([change(k, k - 1) for k in np.linspace(1, len(views) - 1, min(50, len(views) - 1)).astype(int)])
    wrong = np.zeros(len(steps.i), bool)
    for k in rows:
        found = change(steps.i[k], steps.j[k])
        wrong[k] = found > SAME_PICTURE * usual or found == 0
    return steps.refuse(wrong, NOT_THE_FLOOR)


def without_contradiction(steps: Steps, wheels: Float[np.ndarray, "N 3"], errors: WheelErrors) -> Steps:
    """Refuses steps of the whole image that contradict the wheels where these count nothing out of the ordinary.

    One witness does not outweigh the other: the floor's steps may, as several of them check each other.
    """
    image = steps.used & np.isin(steps.kind, ["image", "rotation"])
    counted = between(wheels[steps.i], wheels[steps.j])
    off = log(compose(inverse(steps.i_from_j), counted))
    spread = errors.step_covariance(wheels)
    total = np.cumsum(np.concatenate([np.zeros((1, 3, 3)), spread]), 0)
    wide = steps.covariance + total[steps.i] - total[steps.j]
    wide[:, [0, 1], [0, 1]] += (SLIP_M_PER_RAD * counted[:, 2, None]) ** 2
    distance = np.einsum("ka,kab,kb->k", off, np.linalg.inv(wide), off)
    moved = np.hypot(*np.diff(wheels[:, :2], axis=0).T)
    ordinary = np.hypot(*counted[:, :2].T) <= (steps.i - steps.j) * (3 * np.quantile(moved, 0.95) + 0.05)
    return steps.refuse(image & ordinary & (distance > LIMIT), NOT_THE_WHEELS)
