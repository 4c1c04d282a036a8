"""A recorded run from end to end: driven through the engine, then thought over.

Numerical only: images come from a `load` function, results go back as arrays; files and figures are the command's part.
"""

import time
from collections.abc import Callable
from typing import Any

from ebjax.geometry.camera import Camera
from ebjax.slam.config import PipelineConfig
from ebjax.slam.drive import Progress, drive, in_silence, moved_enough
from ebjax.slam.engine import Engine
from ebjax.slam.finish import asked_of
from ebjax.slam.frame import Update
from ebjax.slam.lean import Lean
from ebjax.slam.mapper import Mapper
from ebjax.slam.recording import Recording
from ebjax.slam.run import Run
from ebjax.slam.store import Store
from ebjax.slam.walker import Remember
from ebjax.views.run_view import RunView

Keep = Callable[[Camera, RunView, Lean | None], Store]
"""(camera, its floor view, how the robot leans) -> where the keyframes of a drive are kept."""
Watch = Callable[[Engine], Callable[[Update], None]]


def run(
    recording: Recording,
    camera: Camera,
    view: RunView | Callable[[Camera], RunView] | None = None,
    config: PipelineConfig | None = None,
    *,
    progress: Progress = in_silence,
    remember: Remember | None = None,
    keep: Keep | None = None,
    watch: Watch = lambda engine: lambda update: None,
) -> Run:
    """Runs the pipeline on a whole recording.

    Args:
      recording: see there.
      camera: of the run.
      view: the floor it looks at, or what chooses it for a camera whose tilt was put right; None: what it sees well.
      config: see there.
      progress: wraps the loop over the frames.
      remember: of a network's name and weights, gives what wraps its functions so that they look up what they know.
      keep: gives where the keyframes of a drive are kept; None: in memory.
      watch: is called with the engine of every drive, and what it gives with every update.

    Raises:
      ValueError: fewer than two frames could be read; wheels are asked for and there is no odometry.
    """
    ways: dict[str, Any] = {"view": view, "recording": recording, "remember": remember}

    def driven(engine: Mapper) -> Mapper:
        begun = time.perf_counter()
        drive(engine, recording, progress, watch(engine))
        engine.seconds["frames"] = time.perf_counter() - begun
        return engine

    def made(camera: Camera, lean: Lean | None, of: Callable[[Camera], RunView]) -> Mapper:
        store = None if keep is None else keep(camera, of(camera), lean)
        return Mapper(camera, config, lean=lean, store=store, **ways)

    def again(engine: Engine, camera: Camera, lean: Lean | None) -> Engine:
        another = driven(made(camera, lean, engine.view_of))
        another.seconds["frames"] += engine.seconds["frames"]
        return another

    blank = Mapper(camera, config, **ways)
    return driven(made(camera, leaning(recording, blank), blank.view_of)).finish(again)


def leaning(recording: Recording, engine: Engine) -> Lean | None:
    """How the robot leans by odometry, and whether the floor views agree with it."""
    config = engine.config
    if recording.level_at is None or config.motion == "wheels":
        return None
    frames = list(range(len(recording)))
    if recording.odom_from_base is not None and config.motion != "floor":
        frames = moved_enough(recording.odom_from_base, config.keyframe_m, config.keyframe_deg)
    return asked_of(engine).leaning("odometry", frames, recording.level_at(0.0))
