"""How the robot moved from keyframe to keyframe: the floor's steps, the wheels, and what each says of the other.

Steps are measured against earlier keyframes; where the floor tells nothing the whole image does. The camera's tilt is
put right by the steps first. Then the wheels' clock, scale, gain and drift are told by the steps, and both together
settle a chain, which names the steps and the counts of the wheels that the others contradict.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Literal

import jax
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from ebjax.features.landmarks import Landmarks, remounted_landmarks
from ebjax.features.settle import PairMatches
from ebjax.geometry.camera import Camera
from ebjax.odometry.bridge import bridge
from ebjax.odometry.chain import Edges
from ebjax.odometry.clock import TimeOffset
from ebjax.odometry.floor_steps import (
    FloorPairs,
    PairsUnder,
    table_of,
    upright_pairs,
    without_body,
    without_contradiction,
)
from ebjax.odometry.fuse import Jump, fuse
from ebjax.odometry.ground import bends, ground_warnings
from ebjax.odometry.height import Reach
from ebjax.odometry.mount import FEWEST, Tilt, refine_tilt
from ebjax.odometry.nods import REST_DEG, levelled_matches, nods, within
from ebjax.odometry.self_check import height_off, mount_warnings, moved_camera, offset_of, reach_of, systematic_of
from ebjax.odometry.steps import Steps, joined, no_steps
from ebjax.odometry.wheels import Systematic, WheelErrors
from ebjax.views.run_view import RunView

Load = Callable[[int], tuple[np.ndarray, np.ndarray | None] | None]
TRUST_DEPTH = 0.03
"""A share of the camera's height: where depth contradicts it by more, the floor's scale is wrong."""


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
      reach: its height and x, where they are estimated; None else.
      jumps: of the odometry.
      carried: steps that nothing measured.
      trust_depth: whether depth contradicts the camera's height so far that it is taken wherever there is any.
      warnings: what the user should correct, a line each.
      pairs: what the floor's steps were measured from.
      bridged: what the whole images measured.
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
    reach: Reach | None
    jumps: tuple[Jump, ...]
    carried: int
    trust_depth: bool
    warnings: tuple[str, ...]
    pairs: FloorPairs
    bridged: Steps


NEAR = 3.0
"""Tolerances within which matches count for what is left of a robot's lean."""


@dataclasses.dataclass(frozen=True)
class MotionConfig:
    """How motion is measured."""

    tolerance_m: float
    refine: Literal["tilt", "all", "none"]
    estimate_offset: bool
    errors: WheelErrors


@dataclasses.dataclass(frozen=True)
class Keyframes:
    """What is known of a run's keyframes before their motion is.

    Attributes:
      frames: frame number of every keyframe.
      times: s.
      pairs_under: verifies pairs of them.
      sample: landmarks of some of them, spread over the run, under the camera as it is given.
      views: floor views, uint8, read when one is asked for.
      view: of the run.
      wheels_at: (what is added to the images' stamps, s) -> odometry at the keyframes; None without wheels.
      load: frame number -> (RGB, depth) for the whole image, where the floor tells nothing; None where images cannot
        be had again.
      ignored: pixels of the image that are no world.
      level_from_base: how the robot leans at every keyframe; None: it does not.
      bridged: steps that were measured by whole images when these came.
    """

    frames: Int[np.ndarray, " N"]
    times: Float[np.ndarray, " N"]
    pairs_under: PairsUnder
    sample: Landmarks
    views: Sequence[UInt8[np.ndarray, "h w 3"]]
    view: RunView
    wheels_at: Callable[[float], Float[np.ndarray, "N 3"]] | None
    load: Load | None
    ignored: Bool[np.ndarray, "H W"] | None
    level_from_base: Float[np.ndarray, "N 4 4"] | None = None
    bridged: Steps | None = None


def fused_motion(keyframes: Keyframes, camera: Camera, start: Float[np.ndarray, "N 3"], config: MotionConfig) -> Motion:
    """Measures steps and settles the chain.

    Args:
      keyframes: see there.
      camera: as it is thought to be mounted.
      start: where the keyframes are thought to be: what is measured against what follows from it.
      config: see there.
    """

    def attempt(camera: Camera) -> Motion:
        refine = config.refine != "none"
        pairs, camera, tilt = upright_pairs(
            keyframes.pairs_under, keyframes.view, camera, start, tolerance_m=config.tolerance_m, refine=refine
        )
        return conclude(keyframes, pairs, camera, tilt, config)

    motion = attempt(camera)
    if config.refine != "all":
        return motion
    wheels = None if keyframes.wheels_at is None else keyframes.wheels_at(motion.offset.offset_s)
    landmarks = remounted_landmarks(keyframes.sample, motion.camera)
    reach = reach_of(motion.steps, landmarks, motion.camera, wheels, motion.wheels, config.errors)
    again = attempt(moved_camera(motion.camera, reach))
    return dataclasses.replace(again, reach=reach, tilt=motion.tilt.further(again.tilt))


def motion_with_closures(motion: Motion, keyframes: Keyframes, closures: FloorPairs, config: MotionConfig) -> Motion:
    """The motion under the tilt that steps and closures together tell; views from opposite sides tell it best."""
    if config.refine == "none" or not closures.believed.any() or motion.pairs.believed.sum() < FEWEST:
        return motion
    camera, more = refine_tilt(
        *both(motion.pairs, closures), motion.camera, config.tolerance_m, certain=not motion.tilt.applied
    )
    tilt = motion.tilt.further(more)
    if not more.applied:
        return dataclasses.replace(motion, tilt=tilt)
    pairs = dataclasses.replace(motion.pairs, settled=None)
    return dataclasses.replace(conclude(keyframes, pairs, camera, tilt, config, motion.bridged), reach=motion.reach)


def both(
    steps: FloorPairs, closures: FloorPairs
) -> tuple[Callable[[Int[np.ndarray, " n"]], PairMatches], Bool[np.ndarray, " K"]]:
    """The matches of steps, then of closures, by their place in the row of all, and which of them are believed."""
    count = len(steps.i)

    def matches(rows: Int[np.ndarray, " n"]) -> PairMatches:
        parts = (steps, rows[rows < count]), (closures, rows[rows >= count] - count)
        some = [pairs.matches(of) for pairs, of in parts if len(of)]
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *some)

    return matches, np.concatenate([steps.believed, closures.believed])


def motion_of_nodding(
    motion: Motion, keyframes: Keyframes, closures: FloorPairs, config: MotionConfig
) -> tuple[Motion, FloorPairs]:
    """The motion, and the closures, with what is left of every keyframe's lean put right.

    Steps hardly tell a slow lean from a scale; views from opposite sides do.

    Args:
      motion: of keyframes that were looked at as the robot leans.
      keyframes: see there.
      closures: candidates; those that are believed count.
      config: see there.
    """
    pairs = motion.pairs
    matches, believed = both(pairs, closures)
    some = matches(np.flatnonzero(believed))
    some = dataclasses.replace(some, matched=within(some, motion.camera, NEAR * config.tolerance_m))
    i, j = (np.concatenate([getattr(pairs, end), getattr(closures, end)])[believed] for end in ("i", "j"))
    found = nods(some, i, j, len(motion.frames), motion.camera, times=keyframes.times, prior_deg=REST_DEG)

    def level(pairs: FloorPairs) -> FloorPairs:
        def levelled(rows: Int[np.ndarray, " n"]) -> PairMatches:
            return levelled_matches(pairs.matches(rows), pairs.i[rows], pairs.j[rows], found, motion.camera)

        return dataclasses.replace(pairs, matches=levelled, settled=None)

    concluded = conclude(keyframes, level(pairs), motion.camera, motion.tilt, config, motion.bridged)
    return dataclasses.replace(concluded, reach=motion.reach), level(closures)


def conclude(
    keyframes: Keyframes,
    pairs: FloorPairs,
    camera: Camera,
    tilt: Tilt,
    config: MotionConfig,
    bridged: Steps | None = None,
) -> Motion:
    """The motion that verified pairs tell under a camera; what the whole images say is measured where not given."""
    count, times, wheels_at = len(keyframes.frames), keyframes.times, keyframes.wheels_at
    landmarks = remounted_landmarks(keyframes.sample, camera)
    trust_depth = height_off(landmarks, camera) > TRUST_DEPTH
    floor = table_of(pairs, camera, config.tolerance_m, trust_depth)
    wheels = None if wheels_at is None else wheels_at(0.0)
    if wheels is not None:
        floor = without_body(floor, wheels, keyframes.views, config.errors)
    if bridged is None and keyframes.load is None:
        bridged = keyframes.bridged or no_steps()
    if bridged is None:
        assert keyframes.load is not None
        known = keyframes.load, config.errors, keyframes.ignored, keyframes.level_from_base
        bridged = bridge(floor, count, keyframes.frames, times, wheels, camera, *known)
    steps = joined([floor, bridged])
    offset, wrong = TimeOffset(), None
    if wheels is not None and wheels_at is not None:
        if config.estimate_offset:
            offset = offset_of(steps, wheels_at, config.errors)
            wheels = wheels_at(offset.offset_s)
        # Only wheels at the images' own times can contradict them.
        steps = without_body(steps, wheels, keyframes.views, config.errors)
        steps = without_contradiction(steps, wheels, config.errors)
        wrong = systematic_of(steps, wheels, times, config.errors)
    settled = fuse(steps, count, times, wheels, wrong, config.errors)
    return Motion(
        frames=keyframes.frames,
        camera=camera,
        poses=settled.poses,
        covariance=settled.covariance,
        chain=settled.chain,
        further=settled.further,
        steps=settled.steps,
        wheels=wrong,
        offset=offset,
        tilt=tilt,
        reach=None,
        jumps=tuple(dataclasses.replace(jump, frame=int(keyframes.frames[jump.frame])) for jump in settled.jumps),
        carried=settled.carried,
        trust_depth=trust_depth,
        warnings=(
            *mount_warnings(wrong, trust_depth, landmarks, camera, config.errors),
            *ground_warnings(bends(pairs, settled.poses, camera, config.tolerance_m), times, settled.poses),
        ),
        pairs=pairs,
        bridged=bridged,
    )
