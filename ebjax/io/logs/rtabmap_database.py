"""RTAB-Map's database (SQLite), opened for reading only: whether it is one, its version, its columns."""

import contextlib
import re
import sqlite3
from collections.abc import Iterator
from pathlib import Path

from ebjax.io.one_line import one_line

OLDEST = (0, 11, 10)
NEWEST = (0, 23)
SQLITE_SIGNATURE = b"SQLite format 3\x00"
TABLES = {"Admin": ("version",), "Node": ("id", "map_id", "pose", "stamp"), "Data": ("id", "image"), "Link": ("type",)}


def is_open_elsewhere(path: Path) -> bool:
    """Tells whether SQLite's journal or write-ahead log lies beside the file."""
    beside = (Path(f"{path}{suffix}") for suffix in ("-wal", "-journal"))
    return any(file.exists() and file.stat().st_size > 0 for file in beside)


def check_file(path: Path) -> bytes:
    """Checks that the file is a whole SQLite database and returns its header of 100 bytes.

    Raises:
      ValueError: no such file, a folder, another kind of file, or a file that was cut off.
    """
    if not path.is_file():
        raise ValueError(f"{path}: {'is a folder' if path.is_dir() else 'no such file'}; name an RTAB-Map database")
    with open(path, "rb") as file:
        header = file.read(100)
    if len(header) < 100 or not header.startswith(SQLITE_SIGNATURE):
        raise ValueError(f"{path}: not a database; give the .db file that RTAB-Map wrote")
    page = int.from_bytes(header[16:18], "big")
    page = 65536 if page == 1 else page
    pages = int.from_bytes(header[28:32], "big") if header[24:28] == header[92:96] else 0
    size = path.stat().st_size
    if size < page * pages and not is_open_elsewhere(path):
        raise ValueError(f"{path}: a truncated database, {size} of {page * pages} bytes; copy it again")
    return header


@contextlib.contextmanager
def reading(path: Path) -> Iterator[sqlite3.Connection]:
    """Opens a database that is never changed. SQLite's errors inside the block become a ValueError.

    A database in write-ahead mode without a log beside it is opened as immutable: else SQLite makes files beside it.

    Raises:
      ValueError: as `check_file`; a database that is locked, was not closed, or is damaged.
    """
    path = path.absolute()
    immutable = check_file(path)[18:20] == b"\x02\x02" and not is_open_elsewhere(path)
    address = f"{path.as_uri()}?mode=ro{'&immutable=1' * immutable}"
    try:
        with contextlib.closing(sqlite3.connect(address, uri=True)) as connection:
            yield connection
    except (sqlite3.Error, UnicodeDecodeError) as error:
        said = one_line(error)
        if "locked" in said:
            raise ValueError(f"{path}: another program writes to it; close RTAB-Map and try again") from None
        if "readonly" in said or "unable to open" in said:
            raise ValueError(
                f"{path}: was not closed ({said}); copy it with its -journal and -wal files into a folder of yours, "
                "and open it there once with RTAB-Map or sqlite3"
            ) from None
        raise ValueError(
            f"{path}: a damaged database ({said}); copy it again, or mend it with rtabmap-recovery"
        ) from None


def columns(database: sqlite3.Connection, table: str) -> frozenset[str]:
    """Names the columns of a table; none where there is no such table."""
    return frozenset(row[1] for row in database.execute(f"PRAGMA table_info({table})"))


def version_from_text(text: str) -> tuple[int, ...] | None:
    """Splits "0.23.8" into (0, 23, 8), which compares as versions do; None where it is no version."""
    return tuple(map(int, text.split("."))) if re.fullmatch(r"\d+(\.\d+)+", text) else None


def check_version(database: sqlite3.Connection, path: Path) -> tuple[int, ...]:
    """Checks that it is RTAB-Map's database and returns the version that created it: that decides every layout.

    Raises:
      ValueError: another SQLite file, or a version before 0.11.10.
    """
    if columns(database, "messages") and columns(database, "topics"):
        raise ValueError(f"{path}: a ROS 2 bag, not an RTAB-Map database; open it as a bag")
    for table, needed in TABLES.items():
        if not columns(database, table) >= set(needed):
            raise ValueError(
                f"{path}: an SQLite file, but not RTAB-Map's (its table {table} is not there); give its .db"
            )
    row = database.execute("SELECT version FROM Admin").fetchone()
    version = version_from_text(str(row[0])) if row else None
    if version is None:
        raise ValueError(f"{path}: its table Admin names no version; give a database that RTAB-Map wrote")
    if version < OLDEST:
        raise ValueError(
            f"{path}: of RTAB-Map {row[0]}, older than 0.11.10, the oldest that is read; "
            "make it anew with rtabmap-reprocess of a newer version"
        )
    return version
