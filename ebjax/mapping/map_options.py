"""What a user says of a map's file: keep a run in it, or do something with it alone."""

import dataclasses
from pathlib import Path

from ebjax.mapping.contents import contents_lines, open_map_to_read, read_contents
from ebjax.mapping.export import export_map
from ebjax.mapping.maintain import drop_views, forget, repaired
from ebjax.mapping.redescribe import redescribe
from ebjax.slam.config import PipelineConfig


@dataclasses.dataclass(frozen=True)
class MapOptions:
    """A map that outlasts runs."""

    map: Path | None = None
    """A map's file, NAME.ebmap. A LOG is kept in it as it is driven; stopped at any moment, the same command goes on
    from there. Without a LOG: says what is in it."""
    localise: bool = False
    """With a LOG: only say where its robot is in --map; nothing is added, and no byte of the map changes."""
    start: tuple[float, float, float] | None = None
    """With --localise: about where it starts, x (m), y (m), heading (degrees), right within 0.3 m and 10 degrees. None:
    it is lost until two views that agree are recognised."""
    export: bool = False
    """Without a LOG: writes what is in --map to --out, at any time, also while a run is written into it: trajectories,
    pose graph, closures, floor map, nav2's map, nerfstudio's transforms.json, hloc's pairs.txt, a report."""
    forget: int | None = None
    """Without a LOG: removes the session of this number from --map."""
    views: bool = True
    """--no-views, without a LOG: drops the colour views of finished sessions from --map, which then is smaller."""
    redescribe: bool = False
    """Without a LOG: describes every keyframe of --map anew from its floor view, with this --extractor, --descriptor,
    --weights and --ranking, and looks for its closures anew, into NAME.redescribed.ebmap beside it; --map stays as it
    is. For a map that was made with others. Stopped at any moment, the same command goes on from there."""
    repair: bool = False
    """Without a LOG: saves what can be read of a damaged --map as NAME.repaired.ebmap beside it."""

    def asked(self) -> list[str]:
        """The flags of what is to be done with the map alone."""
        ways = {
            "--export": self.export,
            "--forget": self.forget is not None,
            "--no-views": not self.views,
            "--redescribe": self.redescribe,
            "--repair": self.repair,
        }
        return [flag for flag, given in ways.items() if given]


def check_map_options(options: MapOptions, log: Path | None) -> None:
    """Refuses flags that do not go together.

    Raises:
      ValueError: names them, and what to leave out or to give.
    """
    asked = options.asked()
    if asked and options.map is None:
        raise ValueError(f"{asked[0]} is for a map: name it with --map FILE.ebmap")
    if len(asked) > 1:
        raise ValueError(f"{' and '.join(asked)}: give one of them at a time")
    if options.start is not None and not options.localise:
        raise ValueError("--start X Y HEADING says where a run begins in a map: give --localise too")
    if options.localise and asked:
        raise ValueError(f"--localise and {asked[0]}: give one of them at a time")
    if options.localise and (options.map is None or log is None):
        raise ValueError("--localise says where a run is in a map: give LOG --map FILE.ebmap --localise")
    if asked and log is not None:
        raise ValueError(f"{asked[0]} is for the map alone: leave {log} out, or run it first without {asked[0]}")


def look_after(path: Path, options: MapOptions, out: Path, metres_per_px: float, config: PipelineConfig) -> list[str]:
    """Does with a map alone what the options ask for; returns what was done, a line each.

    Args:
      path: of the map.
      options: see there.
      out: the folder that --export writes.
      metres_per_px: of the exported floor map.
      config: what --redescribe describes with.

    Raises:
      ValueError, OSError: no such map, a damaged one, no such session, or another process writes to it.
    """
    if options.forget is not None or not options.views:
        open_map_to_read(path).close()
        return drop_views(path) if options.forget is None else forget(path, options.forget)
    if options.redescribe:
        return redescribe(path, config)
    if options.repair:
        return repaired(path)
    with open_map_to_read(path) as kept:
        if not options.export:
            return [*contents_lines(path, read_contents(kept)), *kept.notes]
        done = export_map(kept, out, metres_per_px)
    return [*done.notes, f"{out}: {', '.join(done.files)}"]
