"""Closes loops from opposing views on a run and corrects its trajectory; keeps it in a map's file where asked to."""

import contextlib
import dataclasses
import sys
import time
from functools import partial
from pathlib import Path

import tyro

from ebjax.command import run
from ebjax.front.close import closing, remembering
from ebjax.front.demo import compile_engine, demo
from ebjax.front.log import Log
from ebjax.front.options import Options
from ebjax.io.atomic import check_folder
from ebjax.mapping.localised_run import localise_run
from ebjax.mapping.map_options import MapOptions, check_map_options, look_after
from ebjax.viz.live import Live
from ebjax.viz.run_metrics import brief_lines, summary_lines


@dataclasses.dataclass(frozen=True)
class Config(MapOptions, Options):
    """Finds where the robot drove the other way over the same floor, and corrects its odometry with it."""

    sequence: tyro.conf.Positional[Path | None] = None
    """A log: folder in TUM layout (rgb.txt, camera.json, odometry.txt; depth.txt, groundtruth.txt), ROS bag (.bag,
    .db3, .mcap or their folder), RTAB-Map database, video, folder of images; None: a synthetic one, or --map alone."""
    out: Path = Path("runs/slam")
    """Folder for the results."""
    live: bool = False
    """Show the map, the path and the closures as they come, in rerun's viewer (extra viz)."""
    save_rrd: Path | None = None
    """Record the same into a file for rerun (extra viz)."""


def main(config: Config) -> None:
    """Reads, runs, writes; or looks after a map alone."""
    began_s = time.perf_counter()
    check_map_options(config, config.sequence)
    if config.sequence is None and config.map is not None:
        if config.live or config.save_rrd is not None:
            raise ValueError(f"--{'live' if config.live else 'save-rrd'} shows a run: name a LOG before --map")
        print("\n".join(look_after(config.map, config, config.out, config.map_metres_per_px, config)))
        return
    check_folder(config.out)
    alone = config.sequence is None
    if alone:
        config = dataclasses.replace(config, sequence=demo(config.out / "sequence", partial(compile_engine, config)))
    log = Log(config)
    with contextlib.ExitStack() as at_end:
        if config.localise and config.map is not None:
            for note in (*log.notes, *log.remarks):
                print(note)
            known, seen = remembering(config, at_end), (log.camera, log.view(log.camera))
            told = localise_run(
                config.map, log.recording, *seen, config, config.out, start=config.start, remember=known
            )
            print("\n".join(told))
            return
        live = watching(config, at_end)
        result = at_end.enter_context(closing(log, map=config.map, live=live, began_s=began_s, say=print))
        saved = result.save(config.out)
        for line in result.warnings:
            print(f"warning: {line}", file=sys.stderr)
        if alone:
            print("\n".join((*brief_lines(result.metrics), f"look at {config.out / 'report.html'}")))
            return
        print("\n".join((*saved.notes, *summary_lines(result.metrics))))
        print(saved)


def watching(config: Config, at_end: contextlib.ExitStack) -> Live | None:
    """What shows or records the run, where that is asked for."""
    if not config.live and config.save_rrd is None:
        return None
    return at_end.enter_context(Live(spawn=config.live, save=config.save_rrd))


if __name__ == "__main__":
    run(main, Config)
