"""A new map's file, which appears under its name whole or not at all."""

import contextlib
import errno
import os
import sqlite3
import uuid
from collections.abc import Iterator
from pathlib import Path

from ebjax.io.map_file.connection import beside
from ebjax.io.map_file.faults import sqlite_faults
from ebjax.io.map_file.schema import create_tables


@contextlib.contextmanager
def new_file(path: Path) -> Iterator[sqlite3.Connection]:
    """Yields an empty map to be filled in one transaction.

    Raises:
      FileExistsError: there is such a file.
      OSError: the folder cannot be written, the disk is full, or files of an earlier map of this name lie there, which
        SQLite would take for this one's.
    """
    if path.is_symlink() or path.exists():
        raise FileExistsError(errno.EEXIST, "is there already; name another file, or remove it", str(path))
    for suffix in ("-wal", "-journal"):
        if beside(path, suffix).exists():
            raise OSError(
                f"{beside(path, suffix)}: belongs to an earlier map of this name; put that back, or remove it"
            )
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.parent / f".{path.name}.{uuid.uuid4().hex[:8]}.partial"
    try:
        with open(temporary, "xb"):
            pass
        with sqlite_faults(path), contextlib.closing(sqlite3.connect(temporary, isolation_level=None)) as database:
            database.execute("PRAGMA journal_mode = OFF")  # what fails is thrown away
            database.execute("PRAGMA synchronous = OFF")
            create_tables(database)
            database.execute("BEGIN")
            yield database
            database.execute("COMMIT")
        with open(temporary, "rb") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
