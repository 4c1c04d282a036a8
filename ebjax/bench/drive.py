"""Drives a log through the engine, and says what every keyframe takes as the map grows."""

import dataclasses
import json
import time
from collections.abc import Callable
from pathlib import Path

import tyro

from ebjax.bench.curves import draw
from ebjax.bench.programs import counted
from ebjax.bench.timeline import Timeline
from ebjax.front.log import Log
from ebjax.front.options import Options
from ebjax.front.run import Driven, Run
from ebjax.io.atomic import whole_file
from ebjax.mapping.kept_run import KeptRun, read_as
from ebjax.mapping.watched import Watched
from ebjax.slam.engine import Engine
from ebjax.slam.frame import Update
from ebjax.slam.pipeline import run as run_pipeline


@dataclasses.dataclass(frozen=True)
class DriveConfig(Options):
    """Drives a log through the engine into a map, and says what every keyframe takes as the map grows.

    Writes timeline.json, timeline.png and map.ebmap; ctrl-C ends it with what was measured until then.
    """

    sequence: tyro.conf.Positional[Path | None] = None
    """A log, of any kind that ebjax.slam reads."""
    out: Path = Path("runs/bench")
    """Folder for the results."""


def bench_drive(config: DriveConfig) -> None:
    """Drives, says what it took, then thinks the run over as ebjax.slam does."""
    began_s, kept_in = time.perf_counter(), config.out / "map.ebmap"
    if kept_in.exists():
        raise ValueError(f"{kept_in}: holds an earlier drive; give another --out, or remove it")
    log = Log(config)
    config.out.mkdir(parents=True, exist_ok=True)
    with counted() as programs, KeptRun(kept_in, log.sequence, config, read_as(config)) as kept:
        timeline, watched = Timeline(programs), Watched(len(log))

        def watch(engine: Engine) -> Callable[[Update], None]:
            say, first = watched(engine), not len(timeline.rows)

            def told(update: Update) -> None:
                say(update)
                if first:
                    timeline.told(update)
                    if update.frame + 1 == len(log):
                        concluded(config.out, timeline, kept_in)

            return told

        try:
            result = run_pipeline(log.recording, log.camera, log.view, config, keep=kept, watch=watch)
        except KeyboardInterrupt:
            concluded(config.out, timeline, kept_in)
            raise
        kept.finished(result)
    notes, took_s = (*log.notes, *log.remarks), time.perf_counter() - began_s
    print(Run.of(result, Driven(log.sequence, log.images.both, log.images.broken, config, notes, took_s)).summary())


def concluded(out: Path, timeline: Timeline, kept_in: Path) -> None:
    """Writes and prints what the drive took."""
    with whole_file(out / "timeline.json") as file:
        json.dump(timeline.arrays(), file)
    draw(timeline, out / "timeline.png")
    rows = max(len(timeline.rows), 1)
    print("\n".join(timeline.lines()))
    written = [kept_in, *kept_in.parent.glob(f"{kept_in.name}-wal")]
    print(f"{kept_in}: {sum(file.stat().st_size for file in written) / rows / 1000:.0f} kB a keyframe")
    print(f"{out}: timeline.json, timeline.png, map.ebmap", flush=True)
