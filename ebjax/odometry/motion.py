"""How the robot moved from keyframe to keyframe: the floor's steps, the wheels, and what each says of the other.

Steps are measured against earlier keyframes; where the floor tells nothing the whole image does. The camera's tilt is
put right by the steps first. Then the wheels' clock, scale, gain and drift are told by the steps, and both together
settle a chain, which names the steps and the counts of the wheels that the others contradict.
"""

import dataclasses
from collections.abc import Callable
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from ebjax.features.landmarks import Landmarks, remounted_landmarks
from ebjax.geometry.camera import Camera
from ebjax.odometry.bridge import bridge
from ebjax.odometry.chain import Edges
from ebjax.odometry.clock import TimeOffset
from ebjax.odometry.floor_steps import measure_steps, table_of, without_body
from ebjax.odometry.fuse import Jump, fuse
from ebjax.odometry.height import Reach
from ebjax.odometry.mount import Tilt
from ebjax.odometry.self_check import height_off, mount_warnings, moved_camera, offset_of, reach_of, systematic_of
from ebjax.odometry.steps import Steps, joined
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


@dataclasses.dataclass(frozen=True)
class MotionConfig:
    """How motion is measured."""

    tolerance_m: float
    refine: Literal["tilt", "all", "none"]
    estimate_offset: bool
    seed: int
    errors: WheelErrors


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
    given, reach, total = landmarks, None, Tilt(0.0, 0.0, 0.0, 0.0, 0, False)
    for again in (False, True):
        floor, matches, camera, landmarks, tilt = measure_steps(
            landmarks,
            view,
            camera,
            start,
            tolerance_m=config.tolerance_m,
            refine=config.refine != "none",
            seed=config.seed + 1,
        )
        total = total.further(tilt)
        trust_depth = height_off(landmarks, camera) > TRUST_DEPTH
        if trust_depth:
            columns = floor.i, floor.j, floor.inliers, floor.matches
            floor = table_of(*columns, matches, camera, config.tolerance_m, True)
        wheels = None if wheels_at is None else wheels_at(0.0)
        if wheels is not None:
            floor = without_body(floor, wheels, views, config.errors)
        steps = joined([floor, bridge(floor, count, frames, times, wheels, camera, load, config.errors, ignored)])
        offset, wrong = TimeOffset(), None
        if wheels is not None and wheels_at is not None:
            if config.estimate_offset:
                offset = offset_of(steps, wheels_at, config.errors)
                wheels = wheels_at(offset.offset_s)
            wrong = systematic_of(steps, wheels, times, config.errors)
        if config.refine != "all" or again:
            break
        reach = reach_of(steps, landmarks, camera, wheels, wrong, config.errors)
        camera = moved_camera(camera, reach)
        landmarks = remounted_landmarks(given, camera)
    settled = fuse(steps, count, times, wheels, wrong, config.errors)
    jumps = tuple(dataclasses.replace(jump, frame=int(frames[jump.frame])) for jump in settled.jumps)
    motion = Motion(
        frames=frames,
        camera=camera,
        poses=settled.poses,
        covariance=settled.covariance,
        chain=settled.chain,
        further=settled.further,
        steps=settled.steps,
        wheels=wrong,
        offset=offset,
        tilt=total,
        reach=reach,
        jumps=jumps,
        carried=settled.carried,
        trust_depth=trust_depth,
        warnings=mount_warnings(wrong, trust_depth, landmarks, camera),
    )
    return motion, landmarks
