"""What can be read of an open map."""

import contextlib
import json
import sqlite3
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ebjax.io.map_file import columns
from ebjax.io.map_file.faults import REPAIR, Damaged, sqlite_faults
from ebjax.io.map_file.packed import unpack
from ebjax.io.map_file.rows import Edges, Frames, Keyframes, SessionRow
from ebjax.io.map_file.schema import DamagedRowsError, get, get_all

OF_MAP = 0
"""The session of a state that belongs to the whole map."""


class MapReader:
    """The reading half of `MapFile`. Threads may share it; their calls wait for one another.

    Attributes:
      path: of the file, links resolved.
      notes: what a user should know, a line each.
    """

    def __init__(self, path: Path, database: sqlite3.Connection, notes: tuple[str, ...]):
        self.path, self.notes = path, notes
        self._database, self._guard = database, threading.RLock()

    @contextlib.contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection]:
        with self._guard, sqlite_faults(self.path):
            yield self._database

    @contextlib.contextmanager
    def snapshot(self) -> Iterator[None]:
        """What is read inside the block is of one moment, though a writer goes on. Keep it short: FILE-wal grows."""
        with self._guard:
            with self._reading() as database:
                database.execute("BEGIN")
            try:
                yield
            finally:
                with contextlib.suppress(sqlite3.Error):
                    database.execute("ROLLBACK")

    @property
    def facts(self) -> dict[str, Any]:
        """What must agree with whoever goes on: words, weights, settings."""
        with self._reading() as database:
            for _, facts in get(database, "map"):
                return json.loads(facts)
        raise Damaged(f"{self.path}: its facts are missing; {REPAIR}")

    def sessions(self) -> list[SessionRow]:
        """All sessions, in their order."""
        with self._reading() as database:
            states = database.execute("SELECT session, name FROM state ORDER BY id").fetchall()
            return [
                SessionRow(
                    *(number, name, started, bool(finished), json.loads(facts)),
                    tuple(state for session, state in states if session == number),
                )
                for number, name, started, finished, facts in get_all(database, "sessions")
            ]

    def keyframes(self, session: int | None = None) -> Keyframes:
        """All keyframes, or those of a session."""
        with self._reading() as database:
            return columns.read_keyframes(database, session)

    def frames(self, session: int | None = None) -> Frames:
        """All frames that are no keyframes, or those that a session's keyframes place."""
        with self._reading() as database:
            return columns.read_frames(database, session)

    def edges(self, kind: str | None = None) -> Edges:
        """All edges, or those of a kind."""
        with self._reading() as database:
            return columns.read_edges(database, kind)

    def arrays(self, keyframe: int) -> dict[str, np.ndarray]:
        """The arrays of a keyframe, read-only.

        Raises:
          Damaged: they are not what was written; names the keyframe.
          ValueError: no such keyframe.
        """
        return self._unpacked("keyframe", keyframe, "keyframes WHERE id = ?")

    def edge_arrays(self, edge: int) -> dict[str, np.ndarray]:
        """The arrays of an edge, as `arrays`; none where none were given."""
        return self._unpacked("edge", edge, "edges WHERE id = ? AND has_arrays")

    def _unpacked(self, kind: str, number: int, present: str) -> dict[str, np.ndarray]:
        with self._reading() as database:
            try:
                for _, packed in get(database, f"{kind}_arrays", "WHERE id = ?", (int(number),)):
                    return unpack(packed)
                there = database.execute(f"SELECT 1 FROM {present}", (int(number),)).fetchone()
                known = there or database.execute(f"SELECT 1 FROM {kind}s WHERE id = ?", (int(number),)).fetchone()
            except (DamagedRowsError, sqlite3.DatabaseError) as fault:
                if isinstance(fault, sqlite3.OperationalError | sqlite3.ProgrammingError):
                    raise
                raise Damaged(f"{self.path}: the arrays of {kind} {number} are damaged; {REPAIR}") from None
        if there:
            raise Damaged(f"{self.path}: the arrays of {kind} {number} are missing; {REPAIR}")
        if not known:
            raise ValueError(f"{self.path}: holds no {kind} {number}")
        return {}

    def state(self, session: int, name: str) -> dict[str, np.ndarray]:
        """The arrays that `put_state` kept; none where there are none. Session OF_MAP: of the map."""
        with self._reading() as database:
            for *_, packed in get(database, "state", "WHERE session = ? AND name = ?", (int(session), name)):
                return unpack(packed)
        return {}
