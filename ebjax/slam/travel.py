"""From images to the path before any closure: keyframes looked at, and how the robot moved between them."""

import dataclasses
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from ebjax.features.extractor import Extractor
from ebjax.features.landmarks import remounted_landmarks
from ebjax.features.settle import PairMatches
from ebjax.geometry.camera import Camera
from ebjax.odometry.motion import Keyframes, Motion, MotionConfig, fused_motion, motion_with_closures
from ebjax.places.descriptor import Descriptor
from ebjax.slam.describe import Described
from ebjax.slam.follow import follow
from ebjax.slam.keyframes import Load, Progress, describe_keyframes, moved_enough
from ebjax.slam.lean import Lean, leaning
from ebjax.slam.path import Path, path_of_motion, path_of_wheels
from ebjax.views.run_view import RunView, remounted_view

if TYPE_CHECKING:
    from ebjax.slam.pipeline import PipelineConfig

LOOK_AGAIN_DEG = 0.1
"""A tilt that was off by more shows the floor bent: the images are looked at again under the right one."""


@dataclasses.dataclass(frozen=True)
class Recording:
    """What a run brings: see `ebjax.slam.pipeline.run`."""

    load: Load
    timestamps: Float[np.ndarray, " F"]
    odom_from_base: Float[np.ndarray, "F 3"] | None
    odometry_at: Callable[[float], Float[np.ndarray, "F 3"]] | None
    ignored: Bool[np.ndarray, "H W"] | None
    level_from_base: Float[np.ndarray, "F 4 4"] | None = None


@dataclasses.dataclass(frozen=True)
class Travel:
    """The keyframes' numbers and descriptions under the camera that the run settled on, and the path.

    `motion`, `given` and `looked` (described under the camera as given) are None where wheels alone say the path;
    `lean` where odometry says nothing of roll and pitch.
    """

    keyframes: Int[np.ndarray, " N"]
    described: Described
    camera: Camera
    view: RunView
    path: Path
    motion: Motion | None = None
    given: Keyframes | None = None
    looked: Described | None = None
    way: Float[np.ndarray, "F 3"] | None = None
    lean: Lean | None = None

    def moved_to(self, motion: Motion) -> "Travel":
        """The same where the motion has another camera."""
        assert self.looked is not None and self.way is not None
        landmarks = remounted_landmarks(self.looked.landmarks, motion.camera)
        turned = None if self.looked.turned is None else remounted_landmarks(self.looked.turned, motion.camera)
        return dataclasses.replace(
            self,
            described=dataclasses.replace(self.looked, landmarks=landmarks, turned=turned),
            camera=motion.camera,
            view=remounted_view(self.view, motion.camera),
            path=path_of_motion(motion, self.way),
            motion=motion,
        )

    def with_closures(self, matches: PairMatches, agree: Bool[np.ndarray, " K"], config: MotionConfig) -> "Travel":
        """The same under the tilt that closures tell too."""
        assert self.motion is not None and self.given is not None
        motion = motion_with_closures(self.motion, self.given, matches, agree, config)
        return self if motion is self.motion else self.moved_to(motion)


def motion_config(config: "PipelineConfig", recording: Recording) -> MotionConfig:
    """What of the pipeline's settings the motion needs."""
    return MotionConfig(
        config.tolerance_m, config.mount.refine, recording.odometry_at is not None, config.seed, config.odometry
    )


def travel(
    recording: Recording,
    camera: Camera,
    view_of: Callable[[Camera], RunView],
    chosen: Extractor,
    place: Descriptor,
    config: "PipelineConfig",
    progress: Progress,
    seconds: dict[str, float],
) -> Travel:
    """Looks at the keyframes and measures the motion; again where the camera's tilt turns out to be another."""
    odometry = recording.odom_from_base
    wheels_alone = config.motion == "wheels"
    floor_alone = odometry is None or config.motion == "floor"
    if odometry is None or floor_alone:
        frames = list(range(len(recording.timestamps)))
    else:
        frames = moved_enough(odometry, config.keyframe_m, config.keyframe_deg)
    tilt, lean = None, None
    if recording.level_from_base is not None and not wheels_alone:
        how = recording.level_from_base, camera, view_of(camera), chosen, place, config.seed
        lean = leaning(recording.load, frames, *how)
    level = lean.level_from_base if lean is not None and lean.used else None
    for again in (False, True):
        start = time.perf_counter()
        view = view_of(camera)
        keyframes, described = describe_keyframes(recording.load, frames, camera, view, chosen, place, progress, level)
        seconds["describe"] = seconds.get("describe", 0.0) + time.perf_counter() - start
        if wheels_alone:
            assert odometry is not None
            return Travel(keyframes, described, camera, view, path_of_wheels(odometry, config.odometry))
        start = time.perf_counter()
        found = _moved(recording, keyframes, described, camera, view, floor_alone, config)
        seconds["motion"] = seconds.get("motion", 0.0) + time.perf_counter() - start
        assert found.motion is not None
        off = found.motion.tilt
        if tilt is not None:
            found = dataclasses.replace(found, motion=dataclasses.replace(found.motion, tilt=tilt.further(off)))
        if again or not off.applied or max(abs(off.pitch_deg), abs(off.roll_deg)) < LOOK_AGAIN_DEG:
            break
        tilt, camera = off, found.camera
    return dataclasses.replace(found, lean=lean)


def _moved(
    recording: Recording,
    keyframes: Int[np.ndarray, " N"],
    described: Described,
    camera: Camera,
    view: RunView,
    floor_alone: bool,
    config: "PipelineConfig",
) -> Travel:
    steps, at = motion_config(config, recording), recording.odometry_at
    odometry = recording.odom_from_base
    if odometry is None or floor_alone:
        keyframes, described, way = follow(
            described, keyframes, recording.timestamps, view, camera, config.keyframe_m, config.keyframe_deg, steps
        )
        wheels_at = None
    else:
        way = odometry

        def wheels_at(offset: float) -> Float[np.ndarray, "N 3"]:
            return (way if not offset or at is None else at(offset))[keyframes]

    given = Keyframes(
        keyframes,
        recording.timestamps[keyframes],
        described.landmarks,
        np.asarray(described.view),
        view,
        wheels_at,
        recording.load,
        recording.ignored,
    )
    motion = fused_motion(given, camera, way[keyframes], steps)
    if motion.offset.offset_s and at is not None:
        way = at(motion.offset.offset_s)
    path = path_of_motion(motion, way)
    found = Travel(keyframes, described, camera, view, path, motion, given, described, way)
    return found if motion.camera is camera else found.moved_to(motion)
