"""Closes the loops of a recorded run: what `python -m ebjax.slam` does, files apart."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ebjax.command import setup_jax
from ebjax.evaluation.run import spread_rows
from ebjax.features.landmarks import floor_error_m
from ebjax.front.log import Log
from ebjax.front.options import Options, options_from
from ebjax.front.run import Driven, Run
from ebjax.io.cache import open_cache
from ebjax.mapping.kept_run import KeptRun, read_as
from ebjax.mapping.watched import Watched
from ebjax.parts import is_own
from ebjax.posegraph.robust import kernel_of
from ebjax.slam.pipeline import run as run_pipeline
from ebjax.slam.run import Run as Thought
from ebjax.slam.walker import Remember
from ebjax.viz.live import Live

MOST_IN_MEMORY = 2000
"""A longer run without a map is kept in a temporary map while it is driven: a keyframe takes about 100 kB."""


def close_loops(log: str | Path | Log, *, map: str | Path | None = None, quiet: bool = False, **options: Any) -> Run:
    """Finds where a robot drove over the same floor again, and corrects its trajectory with it.

        run = close_loops("run.bag", camera="calibration.yaml", mount={"height_m": 0.4, "pitch_deg": 25})
        print(run.summary())

    It gives the bits of `python -m ebjax.slam LOG`: JAX is set as that command sets it, to float64 and with compiled
    programs kept for the next time.

    Args:
      log: TUM folder, ROS bag, RTAB-Map database, video or folder of images; or what `open_log` gave.
      map: NAME.ebmap, where the run is kept and recognises the places of earlier ones; None: nowhere.
      quiet: whether to leave out the lines of progress, and of how the log was read, on stderr.
      options: as `python -m ebjax.slam --help` lists them, by their keys: `motion="floor"`, `min_agreeing=1`,
        `mount={"height_m": 0.4}`. `descriptor`, `extractor`, `kernel` and `reader` may be your own, an object or
        `"my_package.mine:NAME"`, whose code is then run.

    Raises:
      ValueError: a log, camera, odometry or option that cannot be; names file, line or option, and the remedy.
      OSError: a file cannot be read or written.
    """
    began_s = time.perf_counter()
    given = {**log.given, **options} if isinstance(log, Log) else {**options, "sequence": log}
    opened = Log(options_from(given, Options, "close_loops"), given)
    with closing(opened, map=None if map is None else Path(map), quiet=quiet, began_s=began_s, read_on=True) as run:
        return run


@contextlib.contextmanager
def closing(
    log: Log,
    *,
    map: Path | None = None,
    live: Live | None = None,
    quiet: bool = False,
    began_s: float | None = None,
    read_on: bool = False,
    say: Callable[[str], None] = lambda line: print(line, file=sys.stderr),
) -> Iterator[Run]:
    """Gives the run; a map holds it as finished when the block is left without a fault.

    Args:
      log: the run.
      map: where it is kept; None: nowhere.
      live: what shows it as it is driven.
      quiet: whether to say nothing.
      began_s: of `time.perf_counter`, when it was begun; None: now.
      read_on: whether what the run reads of a map can be read after the block too.
      say: is told what a user should know, a line at a time.

    Raises:
      ValueError, OSError: as `close_loops`.
    """
    began_s = time.perf_counter() if began_s is None else began_s
    tell = (lambda line: None) if quiet else say
    setup_jax()
    kernel_of(log.options.kernel)
    for note in log.notes:
        tell(note)
    for note in log.remarks:
        tell(note)
    with contextlib.ExitStack() as at_end:
        watched = None if quiet else at_end.enter_context(Watched(len(log), live))
        kept = None
        if map is not None or len(log) > MOST_IN_MEMORY:
            kept = at_end.enter_context(KeptRun(map, log.sequence, log.options, read_as(log.options), tell))
        thought = _driven(log, kept, watched, remembering(log.options, at_end))
        if watched is not None:
            watched.concluded(thought)
        notes, took_s = (*log.notes, *log.remarks), time.perf_counter() - began_s
        driven = Driven(log.sequence, log.images.both, log.images.broken, log.options, notes, took_s)
        run = Run.of(thought, driven)
        yield run
        if kept is not None:
            kept.finished(thought)
            if read_on:
                kept.read_on(run)


def _driven(log: Log, kept: KeptRun | None, watched: Watched | None, remember: Remember | None) -> Thought:
    ways: dict[str, Any] = {"remember": remember, "keep": kept} | ({} if watched is None else {"watch": watched})
    try:
        thought = run_pipeline(log.recording, log.camera, log.view, log.options, **ways)
    except ValueError as fault:
        if not log.images.broken or "could be read" not in str(fault):
            raise
        first = next(iter(log.images.broken.values()))
        raise ValueError(f"{log.sequence.log.colour.source}: {fault}; first {first}") from None
    check_images(log, thought)
    return thought


def remembering(options: Options, at_end: contextlib.ExitStack) -> Remember | None:
    """What looks up in `options.cache` what networks made of a view; the last of what is new is written at the end.

    Parts from outside the package are asked anew each time: what they are made of cannot be known.
    """
    if options.cache is None:
        return None
    folder = options.cache

    def remember(name: str, weights: Path | None) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
        if is_own(name):
            return lambda function: function
        cache = open_cache(folder, name, weights, arithmetic=options.arithmetic, use="slam")
        at_end.callback(cache.flush)
        return cache.remember

    return remember


def check_images(log: Log, run: Thought) -> None:
    """Refuses a run of which too little could be read; warns where depth and camera.json disagree about the floor."""
    sequence, broken, least = log.sequence, log.images.broken, log.options.min_readable
    asked = len(run.keyframes) + len(broken)
    if len(run.keyframes) < least * asked:
        raise ValueError(
            f"{sequence.log.colour.source}: {len(broken)} of {asked} frames could not be read, "
            f"first {next(iter(broken.values()))}; or set --min-readable lower"
        )
    if not sequence.has_depth:
        return
    some = run.looked.stacked_landmarks(spread_rows(np.arange(len(run.keyframes)), 64))
    if not (some.range_m > 0).any():
        raise ValueError(
            f"{sequence.log.depth_source}: no depth on the floor in any of {len(run.keyframes)} frames "
            "(all zero or not finite); check depth_scale in camera.json, or run with --depth none"
        )
    error = floor_error_m(some)
    if run.motion is None and error > 0.05:
        print(
            f"warning: depth sees the floor {error:.2f} m (median) off where T_base_camera puts it; "
            "correct camera.json, or try --floor depth",
            file=sys.stderr,
        )
