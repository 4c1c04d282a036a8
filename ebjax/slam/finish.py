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
from ebjax.odometry.motion import (
    Keyframes,
    Motion,
    MotionConfig,
    fused_motion,
    motion_of_nodding,
    motion_with_closures,
)
from ebjax.slam.believe import CONTRADICTED, OUTVOTED
from ebjax.slam.close import close
from ebjax.slam.engine import Engine
from ebjax.slam.lean import Asked, By, Lean, image_level, shown_by_depth, shown_by_the_floor, used
from ebjax.slam.lens_check import lens_warning
from ebjax.slam.look import Views
from ebjax.slam.medians import looked_through
from ebjax.slam.mirrored import says
from ebjax.slam.path import path_of_motion, path_of_wheels
from ebjax.slam.recall import Alike
from ebjax.slam.run import Run
from ebjax.slam.store import InMemory
from ebjax.views.run_view import remounted_view

LOOK_AGAIN_DEG = 0.1
"""A tilt that was off by more shows the floor bent: the images are looked at again under the right one."""
MUCH_DEG = 0.5
"""A tilt that was off by more may be a lens that bends."""
MANY, FEW_AGREE, OFTEN = 60, 0.4, 0.15
"""Of so many matches of two successive views less than that share agrees, in more than this share of all such pairs."""
MEDIANS = "closures are those of the medians of neighbouring views, which show the floor alone"
WITHOUT_MAP = "without --map, closures are also looked for on the medians of neighbouring views"
SAMPLE = 64
"""Keyframes whose depth says how high the camera is."""
Again = Callable[[Engine, Camera, Lean | None], Engine]
"""(engine, camera, lean) -> an engine through which the same run was driven as that camera, leaning so, sees it."""


@dataclasses.dataclass(frozen=True)
class Moved:
    """How the robot moved: an engine at its end, what is known of its keyframes, their motion, and the way.

    Attributes:
      engine: whose keyframes they are.
      given: what is known of them without the motion.
      motion: see there.
      way: wheels, or the floor followed, at all frames.
    """

    engine: Engine
    given: Keyframes
    motion: Motion
    way: Float[np.ndarray, "F 3"]


def motion_config(engine: Engine) -> MotionConfig:
    """What of the settings the motion needs."""
    config, recording = engine.config, engine.recording
    timed = recording is not None and recording.odometry_at is not None
    return MotionConfig(config.tolerance_m, config.mount.refine, timed, config.odometry)


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
    return through_medians(engine, moved, run) if doubtful or not closed else run


def through_medians(engine: Engine, moved: Moved | None, run: Run) -> Run:
    """The run by the medians of neighbouring views, where its floor mirrors the room and they show more closures.

    Steps from view to view follow what is mirrored, so the wheels alone say the path, where there are any. Few matches
    of medians agree; on a floor that repeats wrong closures have as many, and some of them agree by chance. So the kept
    ones must be more than those that contradict them.

    Args:
      engine: after its last frame.
      moved: how the robot moved.
      run: what came of it.
    """
    mirrored = says(run)
    if mirrored is None or engine.start:
        return dataclasses.replace(run, mirrored=mirrored)
    # A map keeps what was seen; medians are no views that a later run could be compared with.
    if not isinstance(engine.store.store, InMemory):
        return dataclasses.replace(run, mirrored=f"{mirrored}; {WITHOUT_MAP}")
    moved = None if engine.follower is None else moved
    clearer = concluded(looked_through(engine, concluded(engine, moved)), moved)
    wrong = sum(reason in (OUTVOTED, CONTRADICTED) for reason in clearer.reasons)
    if clearer.kept.sum() <= max(run.kept.sum(), wrong):
        return dataclasses.replace(run, mirrored=mirrored)
    return dataclasses.replace(clearer, mirrored=f"{mirrored}; {MEDIANS}")


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


def concluded(engine: Engine, moved: Moved | None) -> Run:
    """The closures that the whole run believes, and what they make of the path."""
    begun = time.perf_counter()
    config, frames, start, every = engine.config, engine.numbers, engine.start, engine.measured()
    own = every.j >= start
    rows = every.rows(np.flatnonzero(own))
    rows = dataclasses.replace(rows, i=rows.i - start, j=rows.j - start)
    closures = engine.looked.pairs(rows.i, rows.j, rows.opposing, since=start)
    if moved is None:
        camera, view, motion, trust_depth = engine.camera, engine.view, None, False
        path = path_of_wheels(engine.frames.odom, config.odometry)
    else:
        motion, steps = moved.motion, motion_config(engine)
        if motion.camera is not engine.camera:
            closures = dataclasses.replace(closures, settled=None)
        motion = motion_with_closures(motion, moved.given, closures, steps)
        if engine.lean is not None and engine.lean.used and engine.lean.by != "odometry" and closures.believed.any():
            motion, closures = motion_of_nodding(motion, moved.given, closures, steps)
        if motion.camera is not engine.camera:
            closures = dataclasses.replace(closures, settled=None)
        camera, view, trust_depth = motion.camera, remounted_view(engine.view, motion.camera), motion.trust_depth
        path = path_of_motion(motion, moved.way)
    i_from_j, covariance, by_depth = closures.measured(camera, config.tolerance_m, trust_depth)
    every = dataclasses.replace(every, i_from_j=every.i_from_j.copy(), covariance=every.covariance.copy())
    every.i_from_j[own], every.covariance[own] = i_from_j, covariance
    engine.seconds["believe"] = time.perf_counter() - begun
    closed = close(engine, path, every)
    candidates = dataclasses.replace(rows, i=frames[rows.i], j=frames[rows.j], i_from_j=i_from_j, covariance=covariance)
    follower, firsts = engine.follower, engine.firsts
    return Run(
        keyframes=frames,
        looked=engine.looked,
        camera=camera,
        view=view,
        motion=motion,
        firsts=Alike(*(getattr(firsts, name)[start:] for name in ("j", "opposing", "distance"))),
        candidates=candidates,
        by_depth=by_depth,
        reasons=[reason for reason, mine in zip(closed.earlier.reasons, own, strict=True) if mine],
        path=path,
        graph=closed.graph,
        solution=closed.solution,
        poses=closed.poses,
        seconds=engine.seconds,
        lean=engine.lean,
        earlier=closed.earlier,
        followed=None if follower is None else (sum(follower.good), len(follower.good)),
    )


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
