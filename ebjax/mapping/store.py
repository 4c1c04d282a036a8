"""The engine's memory in a map's file: every keyframe is there for good as soon as it is kept.

run = {"log": "monday.bag", "first_stamp_s": 0.0, "camera": camera, "view": view, "config": config}
with open_map("building.ebmap", **run) as kept:
    engine = Mapper(camera, config, view=view, store=kept)
    drive(engine, recording)                       # after a kill it goes on behind the last keyframe
    kept.finished(finish(engine, again))
"""

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ebjax.geometry.camera import Camera
from ebjax.io.map_file.file import MapFile
from ebjax.io.map_file.rows import SessionRow
from ebjax.mapping.agreement import check_map, check_session, disagreeing, made_with
from ebjax.mapping.going import Going, tell_camera
from ebjax.mapping.looked_by import NAME, looked_by_arrays
from ebjax.mapping.rows import closure_rows, frame_rows, keyframe_row, step_row
from ebjax.mapping.sessions import AGAIN, AGREES
from ebjax.mapping.shelf import MapShelf
from ebjax.slam.config import PipelineConfig
from ebjax.slam.lean import Lean
from ebjax.slam.packed import Arrays
from ebjax.slam.run import Run
from ebjax.slam.store import Between
from ebjax.views.run_view import RunView


class MapStore(MapShelf):
    """A run that goes into a map.

    Attributes:
      notes: what a user should know, a line each.
    """

    def __init__(self, file: MapFile, going: Going, session: SessionRow, notes: tuple[str, ...] = ()):
        """As `open_map`, `temporary_map` and `again` do."""
        super().__init__(file, session)
        self.notes, self._going = notes, going
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        mine = np.flatnonzero(self._rows.session == session.id)
        if len(mine) and mine[0] + len(mine) != len(self):
            raise ValueError(
                f"{file.path}: session {session.id} of {session.name} was not finished, and session "
                f"{self.piece(-1)} came after it; begin it anew after --map {file.path} --forget {session.id}"
            )
        numbers = file.keyframes().id
        self._next = int(numbers[-1]) + 1 if len(numbers) else 0
        self._pose = file.arrays(int(self._rows.id[-1]))["at.pose"] if len(mine) else None

    def __enter__(self) -> "MapStore":
        return self

    def __exit__(self, *stop: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the map's file; a temporary map is removed.

        Raises:
          OSError: as `MapFile.close`.
        """
        try:
            self.file.close()
        finally:
            if self._temporary is not None:
                self._temporary.cleanup()

    def read_on(self) -> None:
        """Lets others write into the map; what it holds of the run can still be read.

        Raises:
          OSError: as `MapFile.close`.
        """
        self.file.close()
        self.file = MapFile.open(self.file.path, write=False)

    def keep(self, kept: Arrays, name: str = "", between: Sequence[Between] = ()) -> None:
        """Adds a keyframe, its step and its candidates, and the frames since the one before, in one transaction.

        Raises:
          OSError: the disk is full or fails; nothing of the keyframe is written.
        """
        number, edges, frames = self._next, [], []
        whole = self.numbered(kept, number)
        if self._pose is not None:
            before = int(self._rows.id[-1])
            edges.append(step_row(number, before, self._pose, whole))
            frames = frame_rows(between, before)
        row = keyframe_row(number, self.current, name, whole)
        self.add(row, whole, edges + closure_rows(number, whole), frames)
        self._next, self._pose = number + 1, row.pose

    def again(self, camera: Camera, view: RunView, lean: Lean | None = None) -> "MapStore":
        """The same run as that camera, leaning so, sees it: a drive that was killed, or a new one.

        This drive can still be read, and nothing is added to it any more.
        """
        agrees = self._going.agrees(camera, view, lean)
        for one in self._going.sessions(self.file):
            if not one.finished and one.facts[AGAIN] and disagreeing(one.facts[AGREES], agrees) is None:
                session = one
                break
        else:
            session = self._going.begin(self.file, agrees, again=True)
        tell_camera(self.file, session, camera, view)
        another = MapStore(self.file, self._going, session)
        another._temporary = self._temporary
        return another

    def finished(self, run: Run, rest: Sequence[Between] = ()) -> None:
        """Writes what a run that was thought over says, and ends the session; earlier drives of it are removed.

        Args:
          run: of this session's keyframes.
          rest: frames since its last keyframe.
        """
        file = self.file
        placed = set(file.frames(self.current).frame.tolist())
        file.add(frames=frame_rows([one for one in rest if one.frame not in placed], int(self._rows.id[-1])))
        # As the run settled it: what is measured in the map later is measured by it.
        file.put_state(self.current, NAME, looked_by_arrays(run.camera, run.view))
        self.conclude(run.earlier, run.path, run.poses, measured=run.motion is not None)
        self._going.forget_left_over(file)


def open_map(
    path: str | Path,
    *,
    log: str,
    first_stamp_s: float,
    camera: Camera,
    view: RunView,
    config: PipelineConfig,
    lean: Lean | None = None,
    facts: Mapping[str, Any] | None = None,
) -> MapStore:
    """Opens a map for a run, or makes a new one; goes on where the same run was killed, else begins a session.

    Args:
      path: of the map.
      log: name of the run.
      first_stamp_s: time of its first frame; name and time say which run it is.
      camera: as it is mounted.
      view: the floor it looks at.
      config: of the engine.
      lean: how the robot leans, as the engine is told.
      facts: what else changes the frames, as JSON holds it: how the log is read.

    Raises:
      ValueError: the run does not agree with the map, or with its own beginning: names what, and the remedy; no map, or
        a damaged one.
      OSError: as `MapFile.open` and `MapFile.create`.
    """
    going = Going(log, first_stamp_s, config, facts or {})
    made = made_with(config, camera, view)
    path = Path(path)
    file = MapFile.open(path, write=True) if path.exists() else MapFile.create(path, made)
    try:
        notes = check_map(file.path, file.facts, made)
        return _taken_up(file, going, camera, view, lean, notes)
    except BaseException:
        file.close()
        raise


def temporary_map(
    *,
    log: str,
    first_stamp_s: float,
    camera: Camera,
    view: RunView,
    config: PipelineConfig,
    lean: Lean | None = None,
    facts: Mapping[str, Any] | None = None,
    folder: str | Path | None = None,
) -> MapStore:
    """A map for one run that does not fit in memory; it is removed when it is closed.

    Args:
      log: and the following, as `open_map`.
      first_stamp_s: see there.
      camera: see there.
      view: see there.
      config: see there.
      lean: see there.
      facts: see there.
      folder: where; None: $TMPDIR, or the system's.
    """
    temporary = tempfile.TemporaryDirectory(prefix="ebjax-", dir=folder)
    try:
        run: dict[str, Any] = {
            "log": log,
            "first_stamp_s": first_stamp_s,
            "config": config,
            "lean": lean,
            "facts": facts,
        }
        store = open_map(Path(temporary.name) / "run.ebmap", camera=camera, view=view, **run)
    except BaseException:
        temporary.cleanup()
        raise
    store._temporary = temporary
    return store


def _taken_up(
    file: MapFile, going: Going, camera: Camera, view: RunView, lean: Lean | None, notes: tuple[str, ...]
) -> MapStore:
    going.forget_left_over(file)
    before = going.sessions(file)
    begun = [one for one in before if not one.finished and not one.facts[AGAIN]]
    agrees = going.agrees(camera, view, lean)
    if begun:
        session = begun[-1]
        check_session(file.path, session.id, going.log, session.facts[AGREES], agrees)
        count = len(file.keyframes(session.id))
        notes += (f"{file.path}: goes on with session {session.id} of {going.log} after {count} keyframes",)
    else:
        session = going.begin(file, agrees, again=False)
        if before:
            notes += (
                f"{file.path}: holds {going.log} as session {before[-1].id} already; it is added once more, as session "
                f"{session.id} (--forget {session.id} takes it out again)",
            )
    tell_camera(file, session, camera, view)
    return MapStore(file, going, session, (*file.notes, *notes))
