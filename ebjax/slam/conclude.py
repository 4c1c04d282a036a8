"""The end of a run whose motion is known: the closures it believes, and what they make of its path."""

import dataclasses
import time

import numpy as np
from jaxtyping import Float

from ebjax.odometry.motion import Keyframes, Motion, MotionConfig, motion_of_nodding, motion_with_closures
from ebjax.slam.close import close
from ebjax.slam.engine import Engine
from ebjax.slam.path import path_of_motion, path_of_wheels
from ebjax.slam.recall import Alike
from ebjax.slam.run import Run
from ebjax.views.run_view import remounted_view


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


def concluded(engine: Engine, moved: Moved | None, wheels: Float[np.ndarray, "F 3"] | None = None) -> Run:
    """The closures that the whole run believes, and what they make of the path.

    Args:
      engine: after its last frame.
      moved: how the robot moved; None: as the wheels say.
      wheels: what they say, where that is not what they counted.
    """
    begun = time.perf_counter()
    config, frames, start, every = engine.config, engine.numbers, engine.start, engine.measured()
    own = every.j >= start
    rows = every.rows(np.flatnonzero(own))
    rows = dataclasses.replace(rows, i=rows.i - start, j=rows.j - start)
    closures = engine.looked.pairs(rows.i, rows.j, rows.opposing, since=start)
    if moved is None:
        camera, view, motion, trust_depth = engine.camera, engine.view, None, False
        path = path_of_wheels(engine.frames.odom if wheels is None else wheels, config.odometry)
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
