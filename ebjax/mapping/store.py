"""The engine's memory in a map's file: every keyframe is there for good as soon as it is kept.

    run = {"log": "monday.bag", "first_stamp_s": 0.0, "camera": camera, "view": view, "config": config}
    with open_map("building.ebmap", **run) as kept:
        engine = Mapper(camera, config, view=view, store=kept)
        drive(engine, recording)                       # after a kill it goes on behind the last keyframe
        kept.finished(finish(engine, again))

Rows are the keyframes that the engine knows, of all sessions, in the order of their ids.
"""

import dataclasses
import hashlib
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ebjax.geometry.camera import Camera
from ebjax.io.map_file.file import MapFile
from ebjax.io.map_file.rows import SessionRow
from ebjax.mapping.agreement import check_map, check_session, disagreeing, made_with, settings_of
from ebjax.mapping.contents import CLOSURE
from ebjax.mapping.looked_by import NAME, looked_by_arrays
from ebjax.mapping.numbering import with_ids, with_rows
from ebjax.mapping.rows import closure_rows, frame_rows, keyframe_row, step_row
from ebjax.mapping.sessions import AGAIN, AGREES, facts_of, known, left_over, of_run
from ebjax.mapping.walk import packed_walk, unpacked_walk
from ebjax.slam.believe import KEPT
from ebjax.slam.config import PipelineConfig
from ebjax.slam.lean import Lean
from ebjax.slam.packed import Arrays
from ebjax.slam.path import SYSTEMATIC
from ebjax.slam.path import Path as Walk
from ebjax.slam.run import Run
from ebjax.slam.store import Between
from ebjax.views.run_view import RunView

PATH, POSES, MEASURED = "path", "poses", "measured"
"""States of a finished session."""


@dataclasses.dataclass(frozen=True)
class Going:
    """A run that goes into a map.

    Attributes:
      log: its name.
      first_stamp_s: time of its first frame; name and time say which run it is.
      config: of the engine.
      facts: what else must agree to go on with it, as JSON holds it.
    """

    log: str
    first_stamp_s: float
    config: PipelineConfig
    facts: Mapping[str, Any]

    def agrees(self, camera: Camera, view: RunView, lean: Lean | None) -> dict[str, Any]:
        """All that must agree to go on with a drive of it."""
        return {
            **made_with(self.config, camera, view),
            **settings_of(self.config),
            "pixels that are looked at": _digest(view.seen),
            "lean of the robot": "none" if lean is None else f"{lean.by} {lean.used} {_digest(lean.level_from_base)}",
            **self.facts,
        }


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
        self._going, self._temporary = going, None
        self._walks: dict[int, Walk | None] = {}
        keyframes, count = file.keyframes(), len(file.edges())
        rows = np.isin(keyframes.session, list(known(file.sessions(), session)))
        self._ids, self._pieces = keyframes.id[rows].tolist(), keyframes.session[rows].tolist()
        mine = np.flatnonzero(keyframes.session[rows] == session.id)
        if len(mine) and mine[0] + len(mine) != len(self._ids):
            later = self._pieces[-1]
            raise ValueError(
                f"{file.path}: session {session.id} of {session.name} was not finished, and session {later} came after "
                f"it; begin it anew after --map {file.path} --forget {session.id}"
            )
        self._next = int(keyframes.id[-1]) + 1 if len(keyframes) else 0
        self._next_edge = int(file.edges().id[-1]) + 1 if count else 0
        self._pose = file.arrays(self._ids[-1])["at.pose"] if len(mine) else None

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
        return len(self._ids)

    def piece(self, row: int) -> int:
        """The session that a keyframe belongs to."""
        return self._pieces[row]

    def settled_step(self, row: int, kept: Arrays) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """Of a keyframe of an earlier session: its pose on the path, and the covariance of the step to it.

        As its run was thought over at its end; as they came where it never was, or where wheels alone say them.
        """
        session = self._pieces[row]
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
        return with_rows(self.file.arrays(self._ids[row]), np.array(self._ids))

    def keep(self, kept: Arrays, name: str = "", between: Sequence[Between] = ()) -> None:
        """Adds a keyframe, its step and its candidates, and the frames since the one before, in one transaction.

        Raises:
          OSError: the disk is full or fails; nothing of the keyframe is written.
        """
        number, edge, edges = self._next, self._next_edge, []
        whole = with_ids(kept, np.array([*self._ids, number]))
        if self._pose is not None:
            edges.append(step_row(edge, number, self._ids[-1], self._pose, whole))
        edges += closure_rows(edge + len(edges), number, whole)
        frames = frame_rows(between, self._ids[-1]) if self._pose is not None else []
        row = keyframe_row(number, self.current, name, whole)
        self.file.append(row, whole, [(one, {}) for one in edges], frames)
        self._next, self._next_edge, self._pose = number + 1, edge + len(edges), row.pose
        self._ids.append(number)
        self._pieces.append(self.current)

    def again(self, camera: Camera, view: RunView, lean: Lean | None = None) -> "MapStore":
        """The same run as that camera, leaning so, sees it: a drive that was killed, or a new one.

        This drive can still be read, and nothing is added to it any more.
        """
        agrees = self._going.agrees(camera, view, lean)
        for one in of_run(self.file.sessions(), self._going.log, self._going.first_stamp_s):
            if not one.finished and one.facts[AGAIN] and disagreeing(one.facts[AGREES], agrees) is None:
                session = one
                break
        else:
            session = _begun(self.file, self._going, agrees, again=True)
        _tell_camera(self.file, session, camera, view)
        another = MapStore(self.file, self._going, session)
        another._temporary = self._temporary
        return another

    def finished(self, run: Run, rest: Sequence[Between] = ()) -> None:
        """Writes what a run that was thought over says, and ends the session; earlier drives of it are removed.

        Args:
          run: of this session's keyframes.
          rest: frames since its last keyframe.
        """
        file, ids, found = self.file, np.array(self._ids), run.earlier.candidates
        edges = file.edges(CLOSURE)
        ends = zip(edges.i.tolist(), edges.j.tolist(), edges.opposing.tolist(), strict=True)
        known_edges = dict(zip(ends, edges.id.tolist(), strict=True))
        ends = zip(ids[found.i].tolist(), ids[found.j].tolist(), found.opposing.tolist(), strict=True)
        said = {known_edges.get(end): reason for end, reason in zip(ends, run.earlier.reasons, strict=True)}
        said.pop(None, None)  # edges that a repair could not save
        placed = set(file.frames(self.current).frame.tolist())
        file.add(frames=frame_rows([one for one in rest if one.frame not in placed], self._ids[-1]))
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
        _forget_left_over(file, self._going)

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
      folder: where; None: $TMPDIR, or the system's.
    """
    temporary = tempfile.TemporaryDirectory(prefix="ebjax-", dir=folder)
    try:
        run: dict[str, Any] = {"log": log, "first_stamp_s": first_stamp_s, "config": config, "lean": lean}
        store = open_map(Path(temporary.name) / "run.ebmap", camera=camera, view=view, **run)
    except BaseException:
        temporary.cleanup()
        raise
    store._temporary = temporary
    return store


def _taken_up(
    file: MapFile, going: Going, camera: Camera, view: RunView, lean: Lean | None, notes: tuple[str, ...]
) -> MapStore:
    _forget_left_over(file, going)
    before = of_run(file.sessions(), going.log, going.first_stamp_s)
    begun = [one for one in before if not one.finished and not one.facts[AGAIN]]
    agrees = going.agrees(camera, view, lean)
    if begun:
        session = begun[-1]
        check_session(file.path, session.id, going.log, session.facts[AGREES], agrees)
        count = len(file.keyframes(session.id))
        notes += (f"{file.path}: goes on with session {session.id} of {going.log} after {count} keyframes",)
    else:
        session = _begun(file, going, agrees, again=False)
        if before:
            notes += (
                f"{file.path}: holds {going.log} as session {before[-1].id} already; it is added once more, as session "
                f"{session.id} (--forget {session.id} takes it out again)",
            )
    _tell_camera(file, session, camera, view)
    return MapStore(file, going, session, (*file.notes, *notes))


def _begun(file: MapFile, going: Going, agrees: dict[str, Any], *, again: bool) -> SessionRow:
    number = file.begin_session(going.log, facts_of(going.log, going.first_stamp_s, agrees, again=again))
    return next(one for one in file.sessions() if one.id == number)


def _tell_camera(file: MapFile, session: SessionRow, camera: Camera, view: RunView) -> None:
    if NAME not in session.state:
        file.put_state(session.id, NAME, looked_by_arrays(camera, view))


def _forget_left_over(file: MapFile, going: Going) -> None:
    for number in left_over(of_run(file.sessions(), going.log, going.first_stamp_s)):
        file.forget(number)


def _digest(values: Any) -> str:
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()[:16]
