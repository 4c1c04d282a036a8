"""The whole run thought over: the camera's mount, the clocks, the steps and the closures, each by all of the others.

Where the camera was tilted otherwise than was thought, or the robot nods, and the run was recorded, it is driven
through the engine once more as it is known by then.
"""

import dataclasses
import time
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from ebjax.geometry.camera import Camera
from ebjax.odometry.motion import Keyframes, Motion, fused_motion
from ebjax.slam.conclude import Moved, concluded, motion_config
from ebjax.slam.engine import Engine
from ebjax.slam.lean import Asked, By, Lean, image_level, shown_by_depth, shown_by_the_floor, used
from ebjax.slam.lens_check import lens_warning
from ebjax.slam.look import Views
from ebjax.slam.polished import through_medians
from ebjax.slam.run import Run

LOOK_AGAIN_DEG = 0.1
"""A tilt that was off by more shows the floor bent: the images are looked at again under the right one."""
MUCH_DEG = 0.5
"""A tilt that was off by more may be a lens that bends."""
MANY, FEW_AGREE, OFTEN = 60, 0.4, 0.15
"""Of so many matches of two successive views less than that share agrees, in more than this share of all such pairs."""
SAMPLE = 64
"""Keyframes whose depth says how high the camera is."""
Again = Callable[[Engine, Camera, Lean | None], Engine]
"""(engine, camera, lean) -> an engine through which the same run was driven as that camera, leaning so, sees it."""


def finish(engine: Engine, again: Again) -> Run:
    """Thinks a run over.

    Args:
      engine: after its last frame.
      again: drives the run once more, where it was recorded.

    Raises:
      ValueError: fewer than two frames could be read.
    """
    read = len(engine.keyframes) - engine.start
    if read < 2:
        raise ValueError(why_too_few(engine, read))
    begun, driven_s = time.perf_counter(), engine.seconds.get("frames", 0.0)
    engine.corrector.close()
    moved = None
    if engine.config.motion != "wheels":
        moved = think_over(engine, again)
        engine = moved.engine
    again_s = engine.seconds.get("frames", 0.0) - driven_s  # counted already
    engine.seconds["motion"] = time.perf_counter() - begun - again_s
    run = concluded(engine, moved)
    closed, doubtful = run.kept.any() or run.earlier.closures, moved is not None and suspicious(moved.motion)
    return through_medians(engine, moved, run, doubtful) if doubtful or not closed else run


def why_too_few(engine: Engine, read: int) -> str:
    """Why there is no path: images that cannot be read, or a robot that stood still."""
    if read == 0 or engine.broken or len(engine.frames) < 2:
        return f"{read} of {read + len(engine.broken)} frames could be read; at least two are needed"
    by, other = ("floor", "") if engine.follower is not None else ("odometry", ", or --motion floor where it did drive")
    far = f"{engine.config.keyframe_m:g} m and {engine.config.keyframe_deg:g} degrees"
    return (
        f"the robot never moved: by its {by} it stayed within {far} of where it began, in all {len(engine.frames)} "
        f"frames, so there is no loop to close; give the run of a robot that drives{other}"
    )


def think_over(engine: Engine, again: Again) -> Moved:
    """The motion under the tilt and the leans that the run shows."""
    recording = engine.recording

    def upright(engine: Engine) -> Moved:
        found = moved_by(engine)
        tilt = found.motion.tilt
        far = max(abs(tilt.pitch_deg), abs(tilt.roll_deg)) >= LOOK_AGAIN_DEG
        if recording is None or not (tilt.applied and far):
            return found
        more = moved_by(again(engine, found.motion.camera, engine.lean))
        return dataclasses.replace(more, motion=dataclasses.replace(more.motion, tilt=tilt.further(more.motion.tilt)))

    found = upright(engine)
    if recording is None:
        return found
    lean, given = engine.lean, engine.camera
    offset_s = found.motion.offset.offset_s
    asked = asked_of(engine)
    if used(lean) is None and suspicious(found.motion):
        shown = nodding(engine, asked)
        if used(shown) is not None:
            found = upright(again(engine, given, shown))
        elif shown is not None:
            found.engine.lean = shown
    elif lean is not None and lean.by == "odometry" and offset_s and recording.level_at is not None:
        later = recording.level_at(offset_s)
        if later is not None and apart_deg(later, lean.level_from_base) > LOOK_AGAIN_DEG:
            lean = asked.leaning("odometry", engine.numbers.tolist(), later)
            found = upright(again(engine, given, lean))
    return lens_checked(found, asked, engine)


def asked_of(engine: Engine) -> Asked:
    """What the floor views of a recorded run are asked with."""
    assert engine.recording is not None
    ways = engine.eyes.extractor, engine.eyes.descriptor
    return Asked(engine.recording.load, engine.camera, engine.view_of, *ways, engine.config.seed)


def moved_by(engine: Engine) -> Moved:
    """The motion of an engine's keyframes."""
    recording, frames, start = engine.recording, engine.numbers, engine.start
    way = engine.way_everywhere()
    at = None if recording is None or engine.follower is not None else recording.odometry_at
    wheels_at = None
    if engine.follower is None:

        def wheels_at(offset: float) -> Float[np.ndarray, "N 3"]:
            return (way if not offset or at is None else at(offset))[frames]

    spread = np.unique(np.linspace(0, len(frames) - 1, min(len(frames), SAMPLE)).round().astype(int))
    level = image_level(engine.lean)
    given = Keyframes(
        frames=frames,
        times=engine.keyframes.stamp_s[start:],
        pairs_under=lambda camera, i, j: engine.looked.under(camera).pairs(i, j, since=start),
        sample=engine.looked.stacked_landmarks(start + spread),
        views=Views(engine.looked, start + np.arange(len(frames))),
        view=engine.view,
        wheels_at=wheels_at,
        load=None if recording is None else recording.load,
        ignored=None if recording is None else recording.ignored,
        level_from_base=None if level is None else level[frames],
        bridged=engine.bridged_steps(),
    )
    motion = fused_motion(given, engine.camera, way[frames], motion_config(engine))
    if motion.offset.offset_s and at is not None:
        way = at(motion.offset.offset_s)
    return Moved(engine, given, motion, way)


def nodding(engine: Engine, asked: Asked) -> Lean | None:
    """How the robot leans by the depth images, else by the floor views; the first that the views agree with."""
    lean, recording, frames = None, engine.recording, engine.numbers
    assert recording is not None
    wheels = None if engine.follower is not None else recording.odom_from_base
    ways: dict[By, Callable[[], Float[np.ndarray, "F 4 4"] | None]] = {
        "depth": lambda: shown_by_depth(recording.load, frames, engine.camera, len(recording)),
        "floor": lambda: shown_by_the_floor(
            engine.looked, engine.start, frames, recording.timestamps, wheels, asked.seed
        ),
    }
    for by, shown in ways.items():
        lean = asked.leaning(by, frames.tolist(), shown()) or lean
        if used(lean) is not None:
            break
    return lean


def lens_checked(found: Moved, asked: Asked, engine: Engine) -> Moved:
    """The same; with a warning where the mount is off, or many steps fail, and another lens explains more."""
    tilt, warnings = found.motion.tilt, found.motion.warnings
    off = bool(warnings) or max(abs(tilt.pitch_deg), abs(tilt.roll_deg)) > MUCH_DEG
    if asked.camera.lens.model != "pinhole" or not (off or suspicious(found.motion)):
        return found
    warning = lens_warning(asked, (asked.camera, found.motion.camera), engine.numbers)
    if warning is None:
        return found
    return dataclasses.replace(found, motion=dataclasses.replace(found.motion, warnings=(*warnings, warning)))


def apart_deg(one: Float[np.ndarray, "F 4 4"], two: Float[np.ndarray, "F 4 4"]) -> float:
    """How differently a robot leans in the one and the other, degrees, root mean square."""
    return float(np.degrees(np.sqrt(((one - two)[:, 2, :2] ** 2).sum(1).mean())))


def suspicious(motion: Motion) -> bool:
    """Whether more steps fail on the floor than turns and walls explain: the robot may nod."""
    near = (motion.pairs.i - motion.pairs.j == 1) & (motion.pairs.total >= MANY)
    refused = motion.pairs.inliers < FEW_AGREE * motion.pairs.total
    return bool(near.any() and refused[near].mean() > OFTEN)
