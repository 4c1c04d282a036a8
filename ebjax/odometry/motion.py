"""How the robot moved from keyframe to keyframe: the floor's steps, the wheels, and what each says of the other.

Steps are measured against earlier keyframes; where the floor tells nothing the whole image does. The camera's tilt is
put right by the steps first. Then the wheels' clock, scale, gain and drift are told by the steps, and both together
settle a chain, which names the steps and the counts of the wheels that the others contradict.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

from ebjax.features.landmarks import Landmarks, remounted_landmarks, take
from ebjax.features.settle import PairMatches
from ebjax.features.verify_pairs import settle_blocks, verify_blocks
from ebjax.geometry.camera import Camera
from ebjax.geometry.planar import adjoint, between, chained, compose, inverse, log
from ebjax.odometry.bridge import bridge
from ebjax.odometry.chain import CARRIED_M, CARRIED_RAD, Edges, settle_chain
from ebjax.odometry.clock import TimeOffset, estimate_offset
from ebjax.odometry.mount import Tilt, refine_tilt
from ebjax.odometry.partners import partners
from ebjax.odometry.steps import Steps, joined, judged
from ebjax.odometry.wheels import Systematic, WheelErrors, corrected, systematic
from ebjax.views.run_view import RunView

Load = Callable[[int], tuple[np.ndarray, np.ndarray | None] | None]
MIN_DEPTH = 8
STILL_M, STILL_RAD = 0.01, 0.005
SAME_PICTURE = 0.35
"""Two views of a floor that did not move differ by less than this share of what views differ by a step apart."""
CONTRADICTED = "contradicts the other steps"
NOT_THE_FLOOR = "the matches stand still while the robot moves"


@dataclasses.dataclass(frozen=True)
class Jump:
    """A step of the odometry that the floor contradicts: the frame after it, the metres and degrees it counted."""

    frame: int
    metres: float
    degrees: float
    seconds: float


@dataclasses.dataclass(frozen=True)
class Motion:
    """The robot's motion over its N keyframes.

    Attributes:
      frames: frame number of every keyframe.
      camera: with the mount that the steps agree with.
      poses: x, y (m), heading (rad): the settled chain.
      covariance: of each of the N - 1 steps of it, earlier_from_later, right tangent.
      chain: one edge a step: wheels and the floor's step from the keyframe before together.
      further: edges of the steps over longer gaps.
      steps: the table of all that was measured.
      wheels: what is wrong with all of the wheels' steps; None without wheels.
      offset: of the images' clock.
      tilt: of the camera.
      jumps: of the odometry.
      carried: steps that nothing measured.
    """

    frames: Int[np.ndarray, " N"]
    camera: Camera
    poses: Float[np.ndarray, "N 3"]
    covariance: Float[np.ndarray, "M 3 3"]
    chain: Edges
    further: Edges
    steps: Steps
    wheels: Systematic | None
    offset: TimeOffset
    tilt: Tilt
    jumps: tuple[Jump, ...]
    carried: int


@dataclasses.dataclass(frozen=True)
class MotionConfig:
    """How motion is measured."""

    tolerance_m: float
    refine_tilt: bool
    estimate_offset: bool
    seed: int
    errors: WheelErrors


def measure_steps(
    landmarks: Landmarks,
    view: RunView,
    camera: Camera,
    poses: Float[np.ndarray, "N 3"],
    config: MotionConfig,
) -> tuple[Steps, PairMatches, Camera, Landmarks, Tilt]:
    """Measures every keyframe against earlier ones on the floor or by depth; puts the camera's tilt right first."""
    i, j = partners(view, poses)
    here, tilt = landmarks, Tilt(0.0, 0.0, 0.0, 0.0, 0, False)

    def verified(landmarks: Landmarks, camera: Camera):
        def pick(a, b, _):
            return take(landmarks, a), take(landmarks, b)

        facing = np.zeros(len(i), bool)
        found, *_, matches = verify_blocks(
            pick, camera, i, j, facing, tolerance_m=config.tolerance_m, seed=config.seed + 1
        )
        return found.inliers.sum(-1), found.matched.sum(-1), matches

    inliers, total, matches = verified(here, camera)
    if config.refine_tilt:
        for _ in range(2):
            believed = (inliers >= 20) & (inliers >= 0.4 * total)
            camera, more = refine_tilt(matches, believed, camera, config.tolerance_m)
            tilt = dataclasses.replace(
                more,
                pitch_deg=tilt.pitch_deg + more.pitch_deg,
                roll_deg=tilt.roll_deg + more.roll_deg,
                applied=tilt.applied or more.applied,
            )
            if not more.applied:
                break
            here = remounted_landmarks(landmarks, camera)
            inliers, total, matches = verified(here, camera)
    return table_of(i, j, inliers, total, matches, camera, config.tolerance_m), matches, camera, here, tilt


def table_of(i, j, inliers, total, matches: PairMatches, camera: Camera, tolerance_m: float) -> Steps:
    """Verified pairs as steps, measured by the floor or by depth, whichever is more certain."""
    i_from_j, covariance, by_depth = measured(matches, camera, tolerance_m)
    kind = np.where(by_depth, "depth", "floor").astype(object)
    return judged(i, j, kind, inliers, total, i_from_j, covariance)


def measured(
    matches: PairMatches, camera: Camera, tolerance_m: float
) -> tuple[Float[np.ndarray, "K 3"], Float[np.ndarray, "K 3 3"], Bool[np.ndarray, " K"]]:
    """i_from_j and its covariance by floor or depth, whichever is more certain, and which it was."""
    floor, depth, with_depth = settle_blocks(matches, camera, tolerance_m)
    size = [np.trace(m.covariance[:, :2, :2], axis1=1, axis2=2) for m in (floor, depth)]
    by_depth = (with_depth >= MIN_DEPTH) & (size[1] < size[0])
    return (
        np.where(by_depth[:, None], depth.i_from_j, floor.i_from_j).astype(float),
        np.where(by_depth[:, None, None], depth.covariance, floor.covariance).astype(float),
        by_depth,
    )


def fused_motion(
    frames: Int[np.ndarray, " N"],
    times: Float[np.ndarray, " N"],
    landmarks: Landmarks,
    views: np.ndarray,
    view: RunView,
    camera: Camera,
    start: Float[np.ndarray, "N 3"],
    wheels_at: Callable[[float], Float[np.ndarray, "N 3"]] | None,
    load: Load,
    config: MotionConfig,
    ignored: Bool[np.ndarray, "H W"] | None = None,
) -> tuple[Motion, Landmarks]:
    """Measures steps and settles the chain.

    Args:
      frames: frame number of every keyframe.
      times: s.
      landmarks: of the keyframes.
      views: their floor views, uint8.
      view: of the run.
      camera: as it is thought to be mounted.
      start: where the keyframes are thought to be: what is measured against what follows from it.
      wheels_at: (what is added to the images' stamps, s) -> odometry at the keyframes; None without wheels.
      load: frame number -> (RGB, depth) for the whole image, where the floor tells nothing.
      config: see there.
      ignored: pixels of the image that are no world.

    Returns:
      The motion, and the landmarks under its camera.
    """
    count = len(frames)
    steps, _, camera, landmarks, tilt = measure_steps(landmarks, view, camera, start, config)
    wheels = None if wheels_at is None else wheels_at(0.0)
    if wheels is not None:
        steps = _without_body(steps, wheels, views, config.errors)
    steps = joined([steps, bridge(steps, count, frames, times, wheels, camera, load, config.errors, ignored)])
    offset = TimeOffset()
    wrong = None
    if wheels is not None and wheels_at is not None:
        if config.estimate_offset:
            offset = _offset(steps, wheels_at, config.errors)
            wheels = wheels_at(offset.offset_s)
        wrong = _systematic(steps, wheels, times, config.errors)
    chain, further, steps, poses, covariance, jumps, carried = settle(steps, count, times, wheels, wrong, config.errors)
    named = tuple(dataclasses.replace(jump, frame=int(frames[jump.frame])) for jump in jumps)
    return Motion(
        frames, camera, poses, covariance, chain, further, steps, wrong, offset, tilt, named, carried
    ), landmarks


def _without_body(steps: Steps, wheels: Float[np.ndarray, "N 3"], views: np.ndarray, errors: WheelErrors) -> Steps:
    """Refuses steps of no motion where the wheels turned and the views, as a whole, did change or are one and the same.

    Matches that stand still while the robot moves lie on the robot itself, or the camera has frozen.
    """
    still = steps.used & (np.hypot(*steps.i_from_j[:, :2].T) < STILL_M) & (np.abs(steps.i_from_j[:, 2]) < STILL_RAD)
    counted = between(wheels[steps.i], wheels[steps.j])
    allowed = 4 * (errors.translation * np.hypot(*counted[:, :2].T) + 0.005)
    rows = np.flatnonzero(still & (np.hypot(*counted[:, :2].T) > np.maximum(allowed, 3 * STILL_M)))
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


def _consecutive(steps: Steps) -> Int[np.ndarray, " K"]:
    """Rows of the used steps from the keyframe before."""
    return np.flatnonzero(steps.used & (steps.i - steps.j == 1))


def _offset(steps: Steps, wheels_at, errors: WheelErrors) -> TimeOffset:
    rows = _consecutive(steps)
    ends = np.stack([steps.i[rows], steps.j[rows]], 1)
    wheels = wheels_at(0.0)
    noise = errors.step_sigmas(wheels)[steps.j[rows], 2] / 4
    sigma = np.sqrt(steps.covariance[rows, 2, 2] + noise**2)
    return estimate_offset(steps.i_from_j[rows, 2], sigma, lambda offset: wheels_at(offset)[ends, 2])


def _systematic(steps: Steps, wheels: np.ndarray, times: np.ndarray, errors: WheelErrors) -> Systematic:
    rows = _consecutive(steps)
    rows = rows[steps.kind[rows] != "rotation"]
    i, j = steps.i[rows], steps.j[rows]
    sigmas = errors.step_sigmas(wheels)[j]
    return systematic(
        between(wheels[j], wheels[i]),
        inverse(steps.i_from_j[rows]),
        steps.covariance[rows],
        sigmas,
        times[i] - times[j],
        errors,
    )


def settle(
    steps: Steps,
    count: int,
    times: Float[np.ndarray, " N"],
    wheels: Float[np.ndarray, "N 3"] | None,
    wrong: Systematic | None,
    errors: WheelErrors,
) -> tuple[Edges, Edges, Steps, Float[np.ndarray, "N 3"], Float[np.ndarray, "M 3 3"], list[Jump], int]:
    """Settles the chain of wheels and steps; see `Motion` for what comes out."""
    rows = np.arange(count - 1)
    used = np.flatnonzero(steps.used)
    information = _information(steps, used)
    parts = [Edges(steps.i[used], steps.j[used], steps.i_from_j[used], information, np.ones(len(used), bool))]
    start = np.zeros((count - 1, 3))
    if wheels is not None:
        assert wrong is not None
        counted = corrected(wheels, np.diff(times), wrong)
        weights = np.einsum("na,ab->nab", errors.step_sigmas(wheels) ** -2.0, np.eye(3))
        parts.append(Edges(rows, rows + 1, counted, weights, np.ones(count - 1, bool)))
        start = counted.copy()
    first = _consecutive(steps)
    if wheels is not None:
        first = first[steps.kind[first] != "rotation"]
    start[steps.j[first]] = inverse(steps.i_from_j[first])
    start = _carry_gaps(start, steps, wheels, times, count)
    edges = Edges(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    poses, counts = settle_chain(edges, chained(start))
    steps = steps.refuse(np.isin(np.arange(len(steps.i)), used[~counts[: len(used)]]), CONTRADICTED)
    jumps: list[Jump] = []
    believed = np.zeros(count - 1, bool)
    if wheels is not None:
        believed = counts[len(used) :]
        step = between(wheels[:-1], wheels[1:])
        for k in np.flatnonzero(~believed):
            turn = abs(float(np.degrees(step[k, 2])))
            jumps.append(Jump(int(k + 1), float(np.hypot(*step[k, :2])), turn, float(times[k + 1] - times[k])))
    used = np.flatnonzero(steps.used)
    near = used[steps.i[used] - steps.j[used] == 1]
    far = used[steps.i[used] - steps.j[used] > 1]
    chain, measured_steps = _one_edge_a_step(steps, near, parts[1] if wheels is not None else None, believed, poses)
    further = Edges(steps.i[far], steps.j[far], steps.i_from_j[far], _information(steps, far), np.zeros(len(far), bool))
    covariance = _step_covariance(chain, further, poses)
    spanned = np.zeros(count, int)
    np.add.at(spanned, further.j, 1)
    np.add.at(spanned, further.i, -1)
    carried = int((~measured_steps & (np.cumsum(spanned)[:-1] == 0)).sum())
    return chain, further, steps, poses, covariance, jumps, carried


def _information(steps: Steps, rows: Int[np.ndarray, " K"]) -> Float[np.ndarray, "K 3 3"]:
    """Of steps as edges: shared views are not counted twice, and a rotation says nothing of translation."""
    wide = steps.covariance[rows] * steps.share()[rows, None, None]
    information = np.linalg.inv(wide)
    alone = steps.kind[rows] == "rotation"
    information[alone] = np.diag([CARRIED_M**-2, CARRIED_M**-2, 0.0])
    information[alone, 2, 2] = 1 / wide[alone, 2, 2]
    return information


def _carry_gaps(start, steps: Steps, wheels, times, count: int) -> Float[np.ndarray, "M 3"]:
    """Without wheels, a step that nothing measured goes on at the speed of its neighbours."""
    if wheels is not None:
        return start
    known = np.zeros(count - 1, bool)
    first = _consecutive(steps)
    known[steps.j[first]] = True
    if known.all() or not known.any():
        return start
    seconds = np.diff(times)
    middle = (times[1:] + times[:-1]) / 2
    for axis in range(3):
        speed = np.interp(middle, middle[known], start[known, axis] / seconds[known])
        start[~known, axis] = speed[~known] * seconds[~known]
    return start


def _one_edge_a_step(steps: Steps, near, wheels: Edges | None, believed, poses) -> tuple[Edges, Bool[np.ndarray, " M"]]:
    """Wheels and the steps from the keyframe before, fused; and which steps anything measured."""
    count = len(poses)
    rows = np.arange(count - 1)
    relative = between(poses[:-1], poses[1:])
    information = np.tile(np.diag([CARRIED_M**-2, CARRIED_M**-2, CARRIED_RAD**-2]) * 1e-2, (count - 1, 1, 1))
    pull = np.zeros((count - 1, 3))
    known = np.zeros(count - 1, bool)

    def add(at, measured, weight):
        # Both about the settled step: log(settled^-1 measured).
        off = log(compose(inverse(relative[at]), measured))
        np.add.at(information, at, weight)
        np.add.at(pull, at, np.einsum("nab,nb->na", weight, off))
        known[at] = True

    if wheels is not None:
        add(rows[believed], wheels.measured[believed], wheels.information[believed])
    if len(near):
        # i_from_j with i the later: turned round to earlier_from_later.
        back = adjoint(inverse(steps.i_from_j[near]))
        weight = np.swapaxes(back, 1, 2) @ _information(steps, near) @ back
        add(steps.j[near], inverse(steps.i_from_j[near]), weight)
    mean = np.linalg.solve(information, pull[..., None])[..., 0]
    fused = compose(relative, mean)
    return Edges(rows, rows + 1, fused, information, np.zeros(count - 1, bool)), known


def _step_covariance(chain: Edges, further: Edges, poses) -> Float[np.ndarray, "M 3 3"]:
    """Of each step of the chain: its own edge, and its part of the longer steps over it where those know more."""
    information = chain.information.copy()
    gaps = further.i - further.j
    for k in np.flatnonzero(gaps > 1):
        i, j = further.i[k], further.j[k]
        ad = adjoint(between(poses[i], poses[j]))
        covariance = ad @ np.linalg.inv(further.information[k]) @ ad.T
        for row in range(j, i):
            carry = adjoint(between(poses[row + 1], poses[i]))
            mine = np.linalg.inv(carry @ covariance @ carry.T)
            if np.trace(information[row][:2, :2]) < np.trace(mine[:2, :2]):
                information[row] = information[row] + mine / gaps[k]
    return np.linalg.inv(information)
