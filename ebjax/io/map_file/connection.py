"""Opens a map's file for reading or writing, and refuses by name what is none."""

import contextlib
import os
import sqlite3
from pathlib import Path
from typing import Any

from ebjax.io.map_file.faults import REPAIR, Damaged, name_of, translated
from ebjax.io.map_file.schema import APPLICATION_ID, TABLES, VERSION

SIGNATURE = b"SQLite format 3\x00"
WAIT_S = 5.0
KNOWN = {
    frozenset({"Admin", "Node", "Link"}): "an RTAB-Map database, not a map of ebjax; give it as the log",
    frozenset({"topics", "messages"}): "a ROS 2 bag, not a map of ebjax; give it as the log",
}


def open_for_reading(path: Path) -> tuple[sqlite3.Connection, tuple[str, ...]]:
    """Opens a map without changing it; a writer may write meanwhile. Returns the connection and notes.

    Where a writer was killed, what it acknowledged is read from FILE-wal. In a folder that cannot be written SQLite
    needs FILE-shm for that, too; a map that was closed is read there all the same.

    Raises:
      Damaged: a map that is damaged.
      ValueError: no map, or one of a newer version.
      OSError: it may not be read.
    """
    log = beside(path, "-wal")
    had_log, log_bytes = log.exists(), log.stat().st_size if log.exists() else 0
    try:
        database = _checked(path, "mode=ro")
        lacks_log = not had_log and _one(database, "PRAGMA journal_mode") == "wal"
    except OSError:
        if not os.access(path, os.R_OK) or os.access(path.parent, os.W_OK):
            raise
        if log_bytes:
            raise OSError(
                f"{path}: its writer did not close it, and its folder cannot be written; copy it and {log.name} into a "
                "folder of yours and open it there"
            ) from None
        database, lacks_log = _checked(path, "mode=ro&immutable=1"), not had_log
    said = f"{path}: was not closed, and {log.name} is not beside it: what was written last may be missing"
    return database, (said,) * lacks_log


def open_for_writing(path: Path) -> sqlite3.Connection:
    """Opens a map in write-ahead mode; the caller holds its lock.

    Raises:
      as `open_for_reading`.
    """
    if not os.access(path, os.W_OK) or not path.stat().st_mode & 0o222:
        raise OSError(f"{path}: is read-only; allow writing (chmod u+w), or give a copy of it")
    database = _checked(path, "mode=rw")
    try:
        # Without waiting for the disk at each commit: a killed process loses nothing, since the system has the bytes;
        # a power cut loses at most what follows the last checkpoint, never a part of a transaction.
        for statement in (
            "journal_mode = WAL",
            "synchronous = NORMAL",
            "wal_autocheckpoint = 0",
            "secure_delete = OFF",
        ):
            database.execute(f"PRAGMA {statement}")
        return database
    except sqlite3.Error as error:
        database.close()
        raise translated(path, error) from None


def check_file(path: Path) -> None:
    """Refuses what cannot be a database, without opening it: closing a file would free SQLite's locks on it."""
    if path.is_dir():
        raise ValueError(f"{path}: is a folder; name a map's file")
    if not path.exists():
        raise ValueError(f"{path}: no such file; name a map that was written with --map")
    if not path.is_file():
        raise ValueError(f"{path}: not a file; name a map's file")
    if not path.stat().st_size:
        raise ValueError(f"{path}: is empty; remove it, or name a map that was written with --map")


def beside(path: Path, suffix: str) -> Path:
    """SQLite's companion of a file: -wal, -shm, -journal."""
    return path.with_name(path.name + suffix)


def _checked(path: Path, mode: str) -> sqlite3.Connection:
    with contextlib.ExitStack() as stack:
        try:
            database = sqlite3.connect(
                f"{path.as_uri()}?{mode}", uri=True, timeout=WAIT_S, isolation_level=None, check_same_thread=False
            )
            stack.callback(database.close)
            _check_kind(path, database)
        except (sqlite3.Error, UnicodeDecodeError) as error:
            raise _why(path, error) from None
        stack.pop_all()
    return database


def _check_kind(path: Path, database: sqlite3.Connection) -> None:
    application, version = _one(database, "PRAGMA application_id"), _one(database, "PRAGMA user_version")
    tables = frozenset(name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'"))
    if application != APPLICATION_ID:
        found = [words for needed, words in KNOWN.items() if needed <= tables]
        if not found and tables >= TABLES.keys():
            raise Damaged(f"{path}: a map whose first bytes are damaged; {REPAIR}")
        raise ValueError(f"{path}: {[*found, 'an SQLite file of another program, not a map of ebjax'][0]}")
    if version > VERSION:
        raise ValueError(
            f"{path}: a map of version {version}, of a newer ebjax; this one reads version {VERSION}, update it"
        )
    if version < VERSION or not tables >= TABLES.keys():
        raise Damaged(f"{path}: a map whose first bytes are damaged; {REPAIR}")


def _one(database: sqlite3.Connection, statement: str) -> Any:
    return database.execute(statement).fetchone()[0]


def _why(path: Path, error: Exception) -> OSError | ValueError:
    """Looks into a file that SQLite does not open; nothing of this process holds it, whose locks closing would free."""
    if name_of(error).startswith(("SQLITE_NOTADB", "SQLITE_CORRUPT")):
        try:
            with open(path, "rb") as file:
                head = file.read(100)
        except OSError as fault:
            return fault
        if not head.startswith(SIGNATURE):
            return Damaged(f"{path}: not a map, or its first bytes are damaged; if it was one, {REPAIR}")
        size = path.stat().st_size
        page = int.from_bytes(head[16:18], "big")
        whole = (65536 if page == 1 else page) * int.from_bytes(head[28:32], "big")
        if size < whole:
            return Damaged(f"{path}: truncated, {size} of {whole} bytes; copy it again, or {REPAIR}")
    return translated(path, error)
