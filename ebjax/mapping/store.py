"""The engine's memory in a map's file: every keyframe is there for good as soon as it is kept.

    run = {"log": "monday.bag", "first_stamp_s": 0.0, "camera": camera, "view": view, "config": config}
    with open_map("building.ebmap", **run) as kept:
        engine = Mapper(camera, config, view=view, store=kept)
        drive(engine, recording)                       # after a kill it goes on behind the last keyframe
        kept.finished(finish(engine, again))

Rows are the keyframes that the engine knows, of all sessions, in the order of their ids.
"""

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ebjax.geometry.camera import Camera
from ebjax.io.map_file.file import MapFile
from ebjax.io.map_file.rows import SessionRow
from ebjax.mapping.agreement import check_map, check_session, disagreeing, made_with
from ebjax.mapping.contents import CLOSURE
from ebjax.mapping.going import Going, tell_camera
from ebjax.mapping.numbering import with_ids, with_rows
from ebjax.mapping.rows import closure_rows, frame_rows, keyframe_row, step_row
from ebjax.mapping.sessions import AGAIN, AGREES, known
from ebjax.mapping.walk import packed_walk, unpacked_walk
from ebjax.slam.believe import KEPT
from ebjax.slam.config import PipelineConfig
from ebjax.slam.lean import Lean
from ebjax.slam.packed import Arrays
from ebjax.slam.path import SYSTEMATIC
from ebjax.slam.path import Path as Walk
from ebjax.slam.run import Run
from ebjax.slam.store import Between
from ebjax.slam.table import Table
from ebjax.views.run_view import RunView

PATH, POSES, MEASURED = "path", "poses", "measured"
"""States of a finished session."""


class MapStore:
    """A session of an open map that is added to, and all that the engine knows beside it.

    Attributes:
      file: of the map.
      current: number of the session.
      notes: what a user should know, a line each.
    """

    def __init__(self, file: MapFile, going: Going, session: SessionRow, notes: tuple[str, ...] = ()):
        """As `open_map`, `temporary_map` and `again` do."""
        self.file, self.current, self.notes = file, session.id, notes
        self._going = going
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self._walks: dict[int, Walk | None] = {}
        keyframes, self._rows = file.keyframes(), Table(id=int, session=int)
        for k in np.flatnonzero(np.isin(keyframes.session, list(known(file.sessions(), session)))).tolist():
            self._rows.append(id=keyframes.id[k], session=keyframes.session[k])
        mine = np.flatnonzero(self._rows.session == session.id)
        if len(mine) and mine[0] + len(mine) != len(self):
            raise ValueError(
                f"{file.path}: session {session.id} of {session.name} was not finished, and session "
                f"{self.piece(-1)} came after it; begin it anew after --map {file.path} --forget {session.id}"
            )
        self._next = int(keyframes.id[-1]) + 1 if len(keyframes) else 0
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

    def __len__(self) -> int:
        """Returns the number of keyframes."""
        return len(self._rows)

    def piece(self, row: int) -> int:
        """The session that a keyframe belongs to."""
        return int(self._rows.session[row])

    def settled_step(self, row: int, kept: Arrays) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """Of a keyframe of an earlier session: its pose on the path, and the covariance of the step to it.

        As its run was thought over at its end; as they came where it never was, or where wheels alone say them.
        """
        session = self.piece(row)
        if session not in self._walks:
            measured = self.file.state(session, POSES).get(MEASURED, False)
            self._walks[session] = self.path(session) if measured else None
        walk, frame = self._walks[session], int(kept["at.frame"])
        if walk is None:
            return kept["at.pose"], kept["at.step"]
        node = int(np.searchsorted(walk.frames, frame))
        return walk.poses[node], walk.covariance[node - 1] / SYSTEMATIC if node else kept["at.step"]

    def arrays(self, row: int) -> Arrays:
        """Those of a keyframe.

        Raises:
          Damaged: they are not what was written; names the keyframe.
        """
        return with_rows(self.file.arrays(int(self._rows.id[row])), self._rows.id)

    def keep(self, kept: Arrays, name: str = "", between: Sequence[Between] = ()) -> None:
        """Adds a keyframe, its step and its candidates, and the frames since the one before, in one transaction.

        Raises:
          OSError: the disk is full or fails; nothing of the keyframe is written.
        """
        number, edges = self._next, []
        whole = with_ids(kept, np.append(self._rows.id, number))
        if self._pose is not None:
            edges.append(step_row(number, int(self._rows.id[-1]), self._pose, whole))
        edges += closure_rows(number, whole)
        frames = frame_rows(between, int(self._rows.id[-1])) if self._pose is not None else []
        row = keyframe_row(number, self.current, name, whole)
        self.file.append(row, whole, [(one, {}) for one in edges], frames)
        self._next, self._pose = number + 1, row.pose
        self._rows.append(id=number, session=self.current)

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
        file, ids, found = self.file, self._rows.id, run.earlier.candidates
        edges = file.edges(CLOSURE)
        ends = zip(edges.i.tolist(), edges.j.tolist(), edges.opposing.tolist(), strict=True)
        known_edges = dict(zip(ends, edges.id.tolist(), strict=True))
        ends = zip(ids[found.i].tolist(), ids[found.j].tolist(), found.opposing.tolist(), strict=True)
        # A repair may not have saved every edge.
        said = {known_edges[end]: why for end, why in zip(ends, run.earlier.reasons, strict=True) if end in known_edges}
        placed = set(file.frames(self.current).frame.tolist())
        file.add(frames=frame_rows([one for one in rest if one.frame not in placed], int(ids[-1])))
        file.settle(
            ids,
            np.concatenate([run.earlier.poses, run.poses[run.keyframes]]),
            edges=said,
            kept=[reason == KEPT for reason in said.values()],
            reasons=said.values(),
        )
        file.put_state(self.current, PATH, packed_walk(run.path))
        file.put_state(self.current, POSES, {POSES: run.poses, MEASURED: np.array(run.motion is not None)})
        file.end_session(self.current)
        self._going.forget_left_over(file)

    def path(self, session: int) -> Walk:
        """What the closures of a finished session corrected.

        Raises:
          ValueError: no such session, or it is not finished.
        """
        return unpacked_walk(self._state(session, PATH))

    def poses(self, session: int) -> Float[np.ndarray, "F 3"]:
        """The poses of all frames of a finished session: x, y (m), heading (rad).

        Raises:
          ValueError: as `path`.
        """
        return self._state(session, POSES)[POSES]

    def _state(self, session: int, name: str) -> dict[str, np.ndarray]:
        found = self.file.state(session, name)
        if not found:
            raise ValueError(f"{self.file.path}: holds no finished session {session}")
        return found


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
