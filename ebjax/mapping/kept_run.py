"""A recorded run that is kept in a map's file as it is driven."""

import weakref
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ebjax.geometry.camera import Camera
from ebjax.geometry.planar import between
from ebjax.io.sequence import Sequence
from ebjax.mapping.open_run import RunOptions, flags_of
from ebjax.mapping.store import MapStore, open_map, temporary_map
from ebjax.slam.config import PipelineConfig
from ebjax.slam.lean import Lean
from ebjax.slam.run import Run
from ebjax.slam.store import Between
from ebjax.views.run_view import RunView


class KeptRun:
    """Gives the engine where the keyframes of each drive of a run are kept, as `slam.pipeline.run` asks for it.

    with KeptRun(path, sequence, config, facts) as kept:
        result = run(recording, camera, view, config, keep=kept)
        kept.finished(result)
    """

    def __init__(
        self,
        path: Path | None,
        sequence: Sequence,
        config: PipelineConfig,
        facts: Mapping[str, Any],
        say: Callable[[str], None] = print,
    ):
        """Opens nothing yet.

        Args:
          path: of the map; None: a temporary one, which is removed when it is closed.
          sequence: the run.
          config: of the engine.
          facts: how the log is read, as `read_as` says.
          say: is told what a user should know, a line at a time.
        """
        self._path, self._sequence, self._config, self._facts, self._say = path, sequence, config, facts, say
        self._store: MapStore | None = None

    def __call__(self, camera: Camera, view: RunView, lean: Lean | None) -> MapStore:
        """Opens the map for the first drive; for a later one gives another session of it.

        Raises:
          ValueError, OSError: as `open_map`.
        """
        if self._store is not None:
            self._store = self._store.again(camera, view, lean)
            return self._store
        log, begins_s = str(self._sequence.path.resolve()), float(self._sequence.timestamps[0])
        run: dict[str, Any] = {"config": self._config, "lean": lean, "facts": self._facts}
        run |= {"log": log, "first_stamp_s": begins_s, "camera": camera, "view": view}
        self._store = temporary_map(**run) if self._path is None else open_map(self._path, **run)
        for note in self._store.notes:
            self._say(note)
        return self._store

    def finished(self, result: Run) -> None:
        """Writes what the thought over run says and ends its session."""
        if self._path is None:
            return
        assert self._store is not None
        last, sequence = int(result.keyframes[-1]), self._sequence
        rest = [
            Between(k, float(sequence.timestamps[k]), sequence.names[k], between(result.poses[last], result.poses[k]))
            for k in range(last + 1, len(sequence))
        ]
        self._store.finished(result, rest)
        self._say(f"{self._path}: holds the run as session {self._store.current}")

    def read_on(self, run: Run) -> None:
        """Lets others write into the map; what the run reads of it can be read as long as the run is there."""
        assert self._store is not None
        self._store.read_on()
        weakref.finalize(run, self._store.close)
        self._store = None

    def __enter__(self) -> "KeptRun":
        return self

    def __exit__(self, *stop: object) -> None:
        if self._store is not None:
            self._store.close()


def read_as(options: RunOptions) -> dict[str, Any]:
    """The flags that say how a log is read, as they must agree to go on with it.

    The camera and its mount are compared by what they make; the number of the log's frames may grow.
    """
    names = ("depth", "max_time_difference_s", "time_offset_s", "max_gap_s")
    read = {f"--{name.replace('_', '-')}": getattr(options, name) for name in names}
    log = {name: None if value is None else str(value) for name, value in flags_of(options.log).items()}
    return read | log
