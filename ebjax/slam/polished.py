"""The end of a run whose floor mirrors the room: closures by medians of neighbouring views, the path by the wheels."""

import dataclasses
import time
from typing import Literal

import numpy as np
from jaxtyping import Float

from ebjax.geometry.planar import chained, compose
from ebjax.odometry.wheels import Systematic, corrected
from ebjax.slam.believe import CONTRADICTED, OUTVOTED
from ebjax.slam.conclude import Moved, concluded
from ebjax.slam.engine import Engine
from ebjax.slam.medians import looked_through
from ebjax.slam.mirrored import says
from ebjax.slam.run import Run
from ebjax.slam.store import InMemory

BY_WHEELS = "steps follow what is mirrored, so the path is the wheels', turning as the images turn"
MEDIANS = "closures are those of the medians of neighbouring views, which show the floor alone"
WITHOUT_MAP = "without --map, closures are also looked for on the medians of neighbouring views"


def through_medians(engine: Engine, moved: Moved | None, run: Run, doubtful: bool) -> Run:
    """The run as it is where its floor mirrors the room: closures by the medians of neighbouring views.

    Steps from view to view follow what is mirrored. Where many of them fail, the wheels say the path, if there are any.
    Few matches of medians agree; on a floor that repeats wrong closures have as many, and some of them agree by chance.
    So the kept ones must be more than those that contradict them.

    Args:
      engine: after its last frame.
      moved: how the robot moved.
      run: what came of it.
      doubtful: whether many of its steps fail.
    """
    mirrored = says(run)
    if mirrored is None or engine.start or engine.eyes.descriptor.whole_image:
        return dataclasses.replace(run, mirrored=mirrored)
    # A map keeps what was seen; medians are no views that a later run could be compared with.
    if not isinstance(engine.store.store, InMemory):
        return dataclasses.replace(run, mirrored=f"{mirrored}; {WITHOUT_MAP}")
    wheels, plain, said = None, run, mirrored
    if moved is not None and doubtful and engine.follower is None:
        frames = engine.frames
        wheels, moved = turning_as_measured(frames.odom, frames.stamp_s, moved.motion.wheels), None
        plain, said = concluded(engine, moved, wheels), f"{mirrored}; {BY_WHEELS}"
    begun = time.perf_counter()
    another = looked_through(engine, plain)
    engine.seconds["medians"] = time.perf_counter() - begun
    clearer = concluded(another, moved, wheels)
    wrong = sum(reason in (OUTVOTED, CONTRADICTED) for reason in clearer.reasons)
    best = best_of(int(run.kept.sum()), int(clearer.kept.sum()), wrong)
    if best == "medians":
        return dataclasses.replace(clearer, mirrored=f"{said}; {MEDIANS}")
    if best == "wheels":
        return dataclasses.replace(plain, mirrored=said)
    return dataclasses.replace(run, mirrored=mirrored)


def best_of(views: int, medians: int, wrong: int) -> Literal["views", "wheels", "medians"]:
    """By what the end of a run is told.

    Args:
      views: closures kept on single views: where there are some, the steps between them are as good.
      medians: those kept on medians.
      wrong: those on medians that contradict these.
    """
    if medians > max(views, wrong):
        return "medians"
    return "views" if views else "wheels"


def turning_as_measured(
    counted: Float[np.ndarray, "F 3"], stamps: Float[np.ndarray, " F"], wrong: Systematic | None
) -> Float[np.ndarray, "F 3"]:
    """The path of the wheels, their turns as images measured them: a mirrored room turns as the room does.

    Args:
      counted: their path.
      stamps: s.
      wrong: what the images say of all of their steps.
    """
    if wrong is None:
        return counted
    steps = corrected(counted, np.diff(stamps), dataclasses.replace(wrong, scale=1.0))
    return compose(np.broadcast_to(counted[0], counted.shape), chained(steps))
