"""The map's file as the engine uses it: opened once, a keyframe appended in one transaction, read while it is written.

    with MapFile.create("building.ebmap", facts) as kept:
        session = kept.begin_session("monday.bag", {"camera": "left"})
        kept.append(keyframe, arrays, edges=[(edge, {})])

What a call has written when it returns survives the process, however that ends. A power cut may cost the last keyframes
(`checkpoints.LOG_BYTES` of them), and leaves the file as it was after one of its transactions.
"""

import contextlib
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from ebjax.io.map_file import columns
from ebjax.io.map_file.change import Change, change_keyframe_arrays, forget_session, json_of, put_facts
from ebjax.io.map_file.checkpoints import Checkpointer
from ebjax.io.map_file.connection import beside, check_file, open_for_reading, open_for_writing
from ebjax.io.map_file.create import new_file
from ebjax.io.map_file.faults import name_of, sqlite_faults
from ebjax.io.map_file.lock import WriterLock
from ebjax.io.map_file.packed import pack
from ebjax.io.map_file.reader import OF_MAP, MapReader
from ebjax.io.map_file.rows import Arrays, EdgeRow, FrameRow, KeyframeRow, SessionRow
from ebjax.io.map_file.schema import Row, count, get, put


class MapFile(MapReader):
    """An open map; one writer at a time, any number of readers."""

    def __init__(self, path: Path, database: sqlite3.Connection, lock: WriterLock | None, notes: tuple[str, ...] = ()):
        """As `create` and `open` do."""
        super().__init__(path, database, notes)
        self._lock, self._checkpointer = lock, Checkpointer(path, self._guard) if lock else None

    @classmethod
    def create(cls, path: str | Path, facts: Mapping[str, Any]) -> "MapFile":
        """Makes an empty map and opens it for writing.

        Args:
          path: a file that is not there yet.
          facts: what must agree with whoever goes on: words, weights, settings; what JSON holds.

        Raises:
          OSError: the file is there, cannot be written, or lies on a network file system.
          ValueError: facts that JSON does not hold.
        """
        path = Path(path).resolve()
        path.parent.mkdir(parents=True, exist_ok=True)
        with WriterLock(path) as lock:
            with new_file(path) as database:
                put_facts(database, facts)
            return cls(path, open_for_writing(path), lock.kept())

    @classmethod
    def open(cls, path: str | Path, *, write: bool) -> "MapFile":
        """Opens a map; `write=False` changes no byte of the file.

        Raises:
          ValueError: no map, a damaged one (`Damaged`), or one of a newer version.
          OSError: another process writes to it, or it may not be read or written.
        """
        path = Path(path).resolve()
        check_file(path)
        if not write:
            database, notes = open_for_reading(path)
            return cls(path, database, None, notes)
        with WriterLock(path) as lock:
            return cls(path, open_for_writing(path), lock.kept())

    def __enter__(self) -> "MapFile":
        return self

    def __exit__(self, *stop: object) -> None:
        self.close()

    @property
    def writes(self) -> bool:
        """Whether it is open for writing."""
        return self._lock is not None

    def close(self) -> None:
        """Closes the file: one file again with nothing beside it, unless somebody reads it.

        Raises:
          OSError: the disk is full; nothing is lost while FILE-wal stays beside the file.
        """
        if self._checkpointer:
            self._checkpointer.stop()
        try:
            with sqlite_faults(self.path), contextlib.closing(self._database):
                if self._checkpointer:
                    self._checkpointer = None
                    self._tidy()
        except OSError as fault:
            log = beside(self.path, "-wal").name
            said = f"is not tidied up ({fault.strerror or fault}); keep {log} beside it"
            raise OSError(fault.errno, said, str(self.path)) from None
        finally:
            if self._lock:
                self._lock.release()

    def _tidy(self) -> None:
        try:
            for statement in ("busy_timeout = 100", "wal_checkpoint(TRUNCATE)", "journal_mode = DELETE"):
                self._database.execute(f"PRAGMA {statement}").fetchone()
        except sqlite3.OperationalError as error:
            if not name_of(error).startswith(("SQLITE_BUSY", "SQLITE_LOCKED")):
                raise  # else a reader needs FILE-wal; who writes next tidies up

    @contextlib.contextmanager
    def _transaction(self, size: int = 0) -> Iterator[sqlite3.Connection]:
        if not self.writes:
            raise ValueError(f"{self.path}: is open for reading; open it with write=True")
        with self._reading() as database:
            if database.in_transaction:
                raise ValueError(f"{self.path}: nothing is written inside a snapshot; leave it first")
            database.execute("BEGIN IMMEDIATE")
            try:
                yield database
                database.execute("COMMIT")
            except BaseException:
                with contextlib.suppress(sqlite3.Error):
                    database.execute("ROLLBACK")
                raise
        if self._checkpointer:
            self._checkpointer.written(size)

    def begin_session(self, name: str, facts: Mapping[str, Any]) -> int:
        """Begins a session and returns its number."""
        words = json_of(facts)
        with self._transaction() as database:
            number = int(database.execute("INSERT INTO sessions(name) VALUES(NULL)").lastrowid or 0)
            row = (number, str(name), datetime.now(UTC).isoformat("T", "seconds"), 0, words)
            put(database, "sessions", [row], replace=True)
            count(database, sessions=1)
        return number

    def take_session(self, session: SessionRow) -> None:
        """Begins a session that another map has, under its number, name and time.

        Raises:
          ValueError: there is one of this number, or as `begin_session`.
        """
        row = (int(session.id), str(session.name), str(session.started), 0, json_of(session.facts))
        with self._transaction() as database:
            self._insert(database, "sessions", row)
            count(database, sessions=1)

    def end_session(self, session: int) -> None:
        """Marks a session as finished."""
        with self._transaction() as database:
            number, name, started, _, facts = self._session(database, session)
            put(database, "sessions", [(number, name, started, 1, facts)], replace=True)

    def append(
        self,
        keyframe: KeyframeRow,
        arrays: Arrays,
        edges: Sequence[tuple[EdgeRow, Arrays]] = (),
        frames: Sequence[FrameRow] = (),
    ) -> None:
        """Adds a keyframe with its arrays, its edges, and frames that keyframes place, in one transaction.

        Raises:
          ValueError: an id that is there already, an edge or a frame of a keyframe that is not, a session that is not
            begun or is finished, a pose that is not finite.
          OSError: the disk is full; nothing of the call is written.
        """
        if not np.isfinite(keyframe.pose).all():
            raise ValueError(f"keyframe {keyframe.id}: its pose {keyframe.pose} is not finite")
        packed = pack(arrays)
        with self._transaction(len(packed)) as database:
            if self._session(database, keyframe.session)[3]:
                raise ValueError(f"{self.path}: session {keyframe.session} is finished; begin another")
            self._insert(database, "keyframes", columns.keyframe_values(keyframe))
            self._insert(database, "keyframe_arrays", (int(keyframe.id), packed))
            count(database, keyframes=1)
            self._add(database, edges, frames)

    def add(self, edges: Sequence[tuple[EdgeRow, Arrays]] = (), frames: Sequence[FrameRow] = ()) -> None:
        """Adds edges and frames of keyframes that are there, as `append`."""
        with self._transaction() as database:
            self._add(database, edges, frames)

    def _add(
        self, database: sqlite3.Connection, edges: Sequence[tuple[EdgeRow, Arrays]], frames: Sequence[FrameRow]
    ) -> None:
        for number in {int(k) for edge, _ in edges for k in (edge.i, edge.j)} | {int(row.keyframe) for row in frames}:
            self._check_keyframe(database, number)
        for edge, arrays in edges:
            self._insert(database, "edges", columns.edge_values(edge, bool(arrays)))
            if arrays:
                self._insert(database, "edge_arrays", (int(edge.id), pack(arrays)))
        if frames:
            (last,) = database.execute("SELECT coalesce(max(id), 0) FROM frames").fetchone()
            put(database, "frames", [(k, *columns.frame_values(row)) for k, row in enumerate(frames, last + 1)])
        count(database, edges=len(edges), frames=len(frames))

    def _check_keyframe(self, database: sqlite3.Connection, number: int) -> None:
        if not database.execute("SELECT 1 FROM keyframes WHERE id = ?", (number,)).fetchone():
            raise ValueError(f"{self.path}: holds no keyframe {number}; append it before what refers to it")

    def _insert(self, database: sqlite3.Connection, table: str, row: Row) -> None:
        try:
            put(database, table, [row])
        except sqlite3.IntegrityError:
            raise ValueError(f"{self.path}: row {row[0]!r} of {table} is there already; give each id once") from None

    def _session(self, database: sqlite3.Connection, session: int) -> tuple:
        for row in get(database, "sessions", "WHERE id = ?", (int(session),)):
            return row
        found = [str(number) for (number,) in database.execute("SELECT id FROM sessions ORDER BY id")]
        raise ValueError(f"{self.path}: holds no session {session}; it has {', '.join(found) or 'none'}")

    def settle(
        self,
        ids: Sequence[int] | np.ndarray = (),
        poses: np.ndarray | None = None,
        *,
        edges: Iterable[int] = (),
        kept: Iterable[bool] = (),
        reasons: Iterable[str] = (),
    ) -> None:
        """Writes the solved poses (n 3) of keyframes, and which edges are kept and why, in one transaction."""
        numbers = np.asarray(ids, np.int64)
        solved = np.asarray(np.zeros((0, 3)) if poses is None else poses, np.float64)
        if solved.shape != (len(numbers), 3) or not np.isfinite(solved).all():
            raise ValueError(f"{self.path}: {len(numbers)} keyframes need as many finite poses, not {solved.shape}")
        with self._transaction(solved.nbytes) as database:
            for number in {int(numbers.min()), int(numbers.max())} if len(numbers) else ():
                self._check_keyframe(database, number)
            columns.settle_poses(database, numbers, solved)
            missing = columns.settle_edges(database, edges, kept, reasons)
            if missing:
                raise ValueError(f"{self.path}: holds no edge {missing[0]}")

    def put_state(self, session: int, name: str, arrays: Arrays) -> None:
        """Keeps named arrays of a session (OF_MAP: of the map) in place of earlier ones of the name."""
        packed = pack(arrays)
        with self._transaction(len(packed)) as database:
            if session != OF_MAP:
                self._session(database, session)
            found = database.execute("SELECT id FROM state WHERE session = ? AND name = ?", (int(session), name))
            (last,) = database.execute("SELECT coalesce(max(id), 0) FROM state").fetchone()
            (number,) = found.fetchone() or (last + 1,)
            put(database, "state", [(number, int(session), str(name), packed)], replace=True)
            count(database, state=int(number > last))

    def forget(self, session: int) -> None:
        """Removes a session: its keyframes, the frames that they place, every edge that touches one. Shrinks the file.

        Raises:
          ValueError: no such session; names those that there are.
        """
        with self._transaction() as database:
            self._session(database, session)
            forget_session(database, int(session))
        self._shrink()

    def change_arrays(self, change: Change) -> int:
        """Puts `change(keyframe, arrays)` in place of each keyframe's arrays, in one transaction. Shrinks the file.

        FILE-wal grows by all that is changed. Returns how many keyframes changed; None leaves one as it is.
        """
        with self._transaction() as database:
            changed = change_keyframe_arrays(database, change)
        self._shrink()
        return changed

    def _shrink(self) -> None:
        try:
            with self._reading() as database:
                database.execute("VACUUM")
                database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
        except OSError as fault:
            said = fault.strerror or str(fault)
            self.notes += (f"{self.path}: done, but it keeps its size until it is written again ({said})",)
