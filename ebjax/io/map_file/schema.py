"""The tables of a map's file, and the checksum of a row."""

import json
import sqlite3
import zlib
from collections.abc import Iterable, Iterator, Sequence

APPLICATION_ID = 0x45426D70
VERSION = 1
PAGE_BYTES = 4096
"""A keyframe of 120 kB is written fastest with it; larger pages make no smaller file (what is over lies in leaves)."""

COUNTED = ("sessions", "keyframes", "frames", "edges", "settled", "state")
"""Tables whose rows are counted: a page that is damaged may hide some without a word."""
TABLES: dict[str, tuple[str, ...]] = {
    "map": ("facts TEXT",),
    "sessions": ("name TEXT", "started TEXT", "finished INTEGER", "facts TEXT"),
    "keyframes": ("session INTEGER", "frame INTEGER", "stamp_s REAL", "name TEXT", "pose BLOB"),
    "frames": ("frame INTEGER", "stamp_s REAL", "name TEXT", "keyframe INTEGER", "keyframe_from_base BLOB"),
    "edges": (
        *("kind TEXT", "i INTEGER", "j INTEGER", "opposing INTEGER", "kept INTEGER", "reason TEXT", "i_from_j BLOB"),
        *("covariance BLOB", "inliers INTEGER", "matches INTEGER", "distance REAL", "has_arrays INTEGER"),
    ),
    "settled": ("poses BLOB",),
    "keyframe_arrays": ("packed BLOB",),
    "edge_arrays": ("packed BLOB",),
    "state": ("session INTEGER", "name TEXT", "packed BLOB"),
    "counts": tuple(f"{table} INTEGER" for table in COUNTED),
}
"""Columns between `id`, the first of each table, and `crc`, its last."""

Row = Sequence[int | float | str | bytes | None]


def create_tables(database: sqlite3.Connection) -> None:
    """Makes an empty map of a new file."""
    database.execute(f"PRAGMA page_size = {PAGE_BYTES}")
    database.execute(f"PRAGMA application_id = {APPLICATION_ID}")
    database.execute(f"PRAGMA user_version = {VERSION}")
    for table, columns in TABLES.items():
        # A number of a session that was forgotten is not given again.
        key = "INTEGER PRIMARY KEY AUTOINCREMENT" if table == "sessions" else "INTEGER PRIMARY KEY"
        database.execute(f"CREATE TABLE {table}(id {key}, {', '.join(columns)}, crc INTEGER)")
    count_anew(database)


def checksum(table: str, row: Row) -> int:
    """CRC-32 of a row (id first, `crc` left out), as the package's description says."""
    crc = zlib.crc32(json.dumps([table, *(value for value in row if not isinstance(value, bytes))]).encode())
    for value in row:
        if isinstance(value, bytes):
            crc = zlib.crc32(value, crc)
    return crc


def put(database: sqlite3.Connection, table: str, rows: Iterable[Row], *, replace: bool = False) -> None:
    """Inserts rows (id first, `crc` left out)."""
    marks = ", ".join("?" * (len(TABLES[table]) + 2))
    statement = f"INSERT {'OR REPLACE ' * replace}INTO {table} VALUES({marks})"
    database.executemany(statement, ((*row, checksum(table, row)) for row in rows))


def get(database: sqlite3.Connection, table: str, where: str = "", values: Sequence[int | str] = ()) -> Iterator[tuple]:
    """Selects rows in the order of their ids, `crc` checked and left out.

    Raises:
      DamagedRowsError: a row whose checksum is another; names it.
    """
    for *row, crc in database.execute(f"SELECT * FROM {table} {where} ORDER BY id", values):
        if checksum(table, row) != crc:
            raise DamagedRowsError(f"row {row[0]} of its table {table} is not what was written")
        yield tuple(row)


def get_all(database: sqlite3.Connection, table: str) -> list[tuple]:
    """Selects every row of a table.

    Raises:
      DamagedRowsError: as `get`; there are not as many as were written.
    """
    rows, count = list(get(database, table)), counts(database)[table]
    if len(rows) != count:
        raise DamagedRowsError(f"its table {table} gives {len(rows)} rows, not {count}")
    return rows


def counts(database: sqlite3.Connection) -> dict[str, int]:
    """How many rows each counted table has.

    Raises:
      DamagedRowsError: nothing says so.
    """
    for _, *numbers in get(database, "counts"):
        return dict(zip(COUNTED, numbers, strict=True))
    raise DamagedRowsError("the row of its table counts is missing")


def count(database: sqlite3.Connection, **added: int) -> None:
    """Counts rows that were added."""
    put(database, "counts", [(1, *(k + added.get(table, 0) for table, k in counts(database).items()))], replace=True)


def count_anew(database: sqlite3.Connection) -> None:
    """Counts the rows of every table by going through them."""
    numbers = [database.execute(f"SELECT count(*) FROM {table}").fetchone()[0] for table in COUNTED]
    put(database, "counts", [(1, *numbers)], replace=True)


class DamagedRowsError(Exception):
    """Rows are not those that were written."""
