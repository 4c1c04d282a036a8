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
from ebjax.odometry.motion import (
    Keyframes,
    Motion,
    MotionConfig,
    fused_motion,
    motion_of_nodding,
    motion_with_closures,
)
from ebjax.places.descriptor import Descriptor
from ebjax.slam.describe import Described
from ebjax.slam.follow import follow
from ebjax.slam.keyframes import Load, Progress, describe_keyframes, moved_enough
from ebjax.slam.lean import Asked, By, Lean, Look, shown_by_depth, shown_by_the_floor, used
from ebjax.slam.lens_check import lens_warning
from ebjax.slam.path import Path, path_of_motion, path_of_wheels
from ebjax.views.run_view import RunView, remounted_view

if TYPE_CHECKING:
    from ebjax.slam.pipeline import PipelineConfig

LOOK_AGAIN_DEG = 0.1
"""A tilt that was off by more shows the floor bent: the images are looked at again under the right one."""
MUCH_DEG = 0.5
"""A tilt that was off by more may be a lens that bends."""
MANY, FEW_AGREE, OFTEN = 60, 0.4, 0.15
"""Of so many matches of two successive views less than that share agrees, in more than this share of all such pairs."""


@dataclasses.dataclass(frozen=True)
class Recording:
    """What a run brings: see `ebjax.slam.pipeline.run`."""

    load: Load
    timestamps: Float[np.ndarray, " F"]
    odom_from_base: Float[np.ndarray, "F 3"] | None
    odometry_at: Callable[[float], Float[np.ndarray, "F 3"]] | None
    ignored: Bool[np.ndarray, "H W"] | None
    level_at: Callable[[float], Float[np.ndarray, "F 4 4"] | None] | None = None


@dataclasses.dataclass(frozen=True)
class Travel:
    """The keyframes' numbers and descriptions under the camera that the run settled on, and the path.

    `motion`, `given` and `looked` (described under the camera as given) are None where wheels alone say the path;
    `lean` where nothing says how the robot leans. `followed`, without wheels: how many frames the floor showed to
    follow on the one before, and of how many.
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
    followed: tuple[int, int] | None = None
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

    def with_closures(
        self,
        matches: PairMatches,
        agree: Bool[np.ndarray, " K"],
        i: Int[np.ndarray, " K"],
        j: Int[np.ndarray, " K"],
        config: MotionConfig,
    ) -> tuple["Travel", PairMatches]:
        """The same, and the closures' matches, under the tilt and, where the robot nods, the leans that these tell."""
        assert self.motion is not None and self.given is not None
        motion = motion_with_closures(self.motion, self.given, matches, agree, config)
        if self.lean is not None and self.lean.used and self.lean.by != "odometry" and agree.any():
            motion, matches = motion_of_nodding(motion, self.given, matches, agree, i, j, config)
        return (self if motion is self.motion else self.moved_to(motion)), matches


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
    """Looks at the keyframes and measures the motion; again where the camera's tilt is another, or the robot nods."""
    odometry = recording.odom_from_base
    floor_alone = odometry is None or config.motion == "floor"
    if odometry is None or floor_alone:
        frames = list(range(len(recording.timestamps)))
    else:
        frames = moved_enough(odometry, config.keyframe_m, config.keyframe_deg)

    def look(camera: Camera, lean: Lean | None) -> Look:
        start = time.perf_counter()
        view = view_of(camera)
        found = describe_keyframes(recording.load, frames, camera, view, chosen, place, progress, used(lean))
        seconds["describe"] = seconds.get("describe", 0.0) + time.perf_counter() - start
        return Look(*found, camera, view, lean)

    def move(first: Look, lean: Lean | None) -> Travel:
        found = _moved(recording, first, floor_alone, config)
        assert found.motion is not None
        tilt = found.motion.tilt
        if not tilt.applied or max(abs(tilt.pitch_deg), abs(tilt.roll_deg)) < LOOK_AGAIN_DEG:
            return found
        again = _moved(recording, look(found.camera, lean), floor_alone, config)
        assert again.motion is not None
        motion = dataclasses.replace(again.motion, tilt=tilt.further(again.motion.tilt))
        return dataclasses.replace(again, motion=motion)

    if config.motion == "wheels":
        assert odometry is not None
        seen = look(camera, None)
        return Travel(seen.keyframes, seen.described, camera, seen.view, path_of_wheels(odometry, config.odometry))
    start = time.perf_counter()
    level_at = recording.level_at or (lambda _: None)
    asked = Asked(recording.load, camera, view_of, chosen, place, config.seed)
    lean = asked.leaning("odometry", frames, level_at(0.0))
    first = look(camera, lean)
    found = move(first, lean)
    assert found.motion is not None
    offset_s = found.motion.offset.offset_s
    if used(lean) is None and suspicious(found.motion):
        shown = nodding(recording, first, asked, None if floor_alone else odometry)
        lean = shown or lean
        if used(shown) is not None:
            found = move(look(camera, shown), shown)
    elif lean is not None and offset_s:
        later = level_at(offset_s)
        if later is not None and apart_deg(later, lean.level_from_base) > LOOK_AGAIN_DEG:
            lean = asked.leaning("odometry", frames, later)
            found = move(look(camera, lean), lean)
    found = _lens_checked(found, asked, first.keyframes)
    seconds["motion"] = time.perf_counter() - start - seconds["describe"]
    return dataclasses.replace(found, lean=lean)


def nodding(recording: Recording, seen: Look, asked: Asked, wheels: Float[np.ndarray, "F 3"] | None) -> Lean | None:
    """How the robot leans by the depth images, else by the floor views; the first that the views agree with."""
    lean, count = None, len(recording.timestamps)
    ways: dict[By, Callable[[], Float[np.ndarray, "F 4 4"] | None]] = {
        "depth": lambda: shown_by_depth(recording.load, seen.keyframes, seen.camera, count),
        "floor": lambda: shown_by_the_floor(seen, recording.timestamps, wheels, asked.seed),
    }
    for by, shown in ways.items():
        lean = asked.leaning(by, seen.keyframes.tolist(), shown()) or lean
        if used(lean) is not None:
            break
    return lean


def _lens_checked(found: Travel, asked: Asked, keyframes: Int[np.ndarray, " N"]) -> Travel:
    """The same; with a warning where the mount is off, or many steps fail, and another lens explains more."""
    assert found.motion is not None
    tilt, warnings = found.motion.tilt, found.motion.warnings
    off = bool(warnings) or max(abs(tilt.pitch_deg), abs(tilt.roll_deg)) > MUCH_DEG
    if asked.camera.lens.model != "pinhole" or not (off or suspicious(found.motion)):
        return found
    believed = asked.camera, found.camera
    warning = lens_warning(asked, believed, keyframes)
    if warning is None:
        return found
    return dataclasses.replace(found, motion=dataclasses.replace(found.motion, warnings=(*warnings, warning)))


def apart_deg(one: Float[np.ndarray, "F 4 4"], two: Float[np.ndarray, "F 4 4"]) -> float:
    """How differently a robot leans in the one and the other, degrees, root mean square."""
    return float(np.degrees(np.sqrt(((one - two)[:, 2, :2] ** 2).sum(1).mean())))


def suspicious(motion: Motion | None) -> bool:
    """Whether more steps fail on the floor than turns and walls explain: the robot may nod."""
    if motion is None:
        return False
    near = (motion.pairs.i - motion.pairs.j == 1) & (motion.pairs.total >= MANY)
    refused = motion.pairs.inliers < FEW_AGREE * motion.pairs.total
    return bool(near.any() and refused[near].mean() > OFTEN)


def _moved(recording: Recording, seen: Look, floor_alone: bool, config: "PipelineConfig") -> Travel:
    keyframes, described, camera, view = seen.keyframes, seen.described, seen.camera, seen.view
    # What floor views say of a lean says little in turns, where the whole image is asked.
    level = None if seen.lean is None or seen.lean.by == "floor" else used(seen.lean)
    steps, at = motion_config(config, recording), recording.odometry_at
    odometry = recording.odom_from_base
    if odometry is None or floor_alone:
        keyframes, described, way, good = follow(
            described, keyframes, recording.timestamps, view, camera, config.keyframe_m, config.keyframe_deg, steps
        )
        wheels_at, followed = None, (int(good.sum()), len(good))
    else:
        way, followed = odometry, None

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
        None if level is None else level[keyframes],
    )
    motion = fused_motion(given, camera, way[keyframes], steps)
    if motion.offset.offset_s and at is not None:
        way = at(motion.offset.offset_s)
    path = path_of_motion(motion, way)
    found = Travel(keyframes, described, camera, view, path, motion, given, described, way, followed)
    return found if motion.camera is camera else found.moved_to(motion)
