"""Saves what can be read of a damaged map into a new file; the damaged one is not touched."""

import contextlib
import itertools
import sqlite3
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ebjax.io.map_file.change import put_facts
from ebjax.io.map_file.columns import BLOCK
from ebjax.io.map_file.connection import beside, check_file
from ebjax.io.map_file.create import new_file
from ebjax.io.map_file.lock import WriterLock
from ebjax.io.map_file.pages import Pages, found_rows
from ebjax.io.map_file.schema import COUNTED, TABLES, DamagedRowsError, count_anew, counts, put

MOST_NAMED = 20
UNNAMED = "lost"
OWNERS = (
    *("SELECT id FROM keyframe_arrays", "SELECT i AS id FROM edges", "SELECT j AS id FROM edges"),
    "SELECT keyframe AS id FROM frames",
)
"""What names a keyframe."""
NAMES = {
    **{table: table for table in COUNTED},
    "frames": "frames between keyframes",
    "settled": f"blocks of solved poses ({BLOCK} keyframes each); the poses of when they were added are kept",
    "state": "states of sessions",
}
HOMELESS = {
    "frames": "keyframe NOT IN (SELECT id FROM keyframes)",
    "edges": "i NOT IN (SELECT id FROM keyframes) OR j NOT IN (SELECT id FROM keyframes)",
    "keyframe_arrays": "id NOT IN (SELECT id FROM keyframes)",
    "edge_arrays": "id NOT IN (SELECT id FROM edges WHERE has_arrays)",
}
"""Rows without what they belong to, in the order in which they are removed."""


@dataclass(frozen=True)
class Report:
    """What a repair saved, and what it could not.

    Attributes:
      out: the new file.
      saved: rows of each table.
      lost: a line each.
    """

    out: Path
    saved: dict[str, int]
    lost: tuple[str, ...]

    def summary(self) -> str:
        """The counts in one line."""
        counts = ", ".join(f"{self.saved[table]} {table}" for table in ("sessions", "keyframes", "frames", "edges"))
        return f"{self.out}: saved {counts}; {'nothing is lost' if not self.lost else 'lost is what follows'}"


def repair(path: str | Path, out: str | Path) -> Report:
    """Saves every session, keyframe and edge that can be read into a new file.

    Rows are found page by page, so that a truncated file or one without its head gives what is left of it. Where
    FILE-wal lies beside the file, what it holds counts.

    Args:
      path: a map, damaged or not.
      out: a file that is not there yet.

    Raises:
      ValueError: no row of a map is in the file.
      OSError: a process writes to the map; `out` is there, or cannot be written.
    """
    path, out = Path(path).resolve(), Path(out).resolve()
    check_file(path)
    with _unwritten(path), new_file(out) as database:
        damaged = _save(database, Pages(path, beside(path, "-wal")))
        saved = {table: _number(database, f"SELECT count(*) FROM {table}") for table in TABLES}
        if not any(saved.values()):
            raise ValueError(f"{path}: no row of a map can be read in it; it was none, or nothing of it is left")
        lost = tuple(_mended(database, damaged))
        saved = {table: _number(database, f"SELECT count(*) FROM {table}") for table in TABLES}
    return Report(out, saved, lost)


@contextlib.contextmanager
def _unwritten(path: Path) -> Iterator[None]:
    """Holds the map's lock, except in a folder where nobody can write."""
    try:
        lock = WriterLock(path)
    except PermissionError:
        yield
        return
    with lock:
        yield


def _save(database: sqlite3.Connection, pages: Pages) -> dict[str, set[int]]:
    """Copies every sound row; returns the numbers of damaged ones."""
    damaged: dict[str, set[int]] = {table: set() for table in TABLES}
    database.execute("DELETE FROM counts")  # of the new file
    for found in found_rows(pages):
        if found.row is None:
            damaged[found.table].add(found.id)
        else:
            put(database, found.table, [found.row], replace=True)
    return damaged


def _mended(database: sqlite3.Connection, damaged: dict[str, set[int]]) -> Iterator[str]:
    """Makes a whole map of the rows that were saved; yields what is lost."""
    try:
        written = counts(database)
    except DamagedRowsError:
        written = {}
        yield "how many rows there were: others than the following may be lost"
    if not _numbers(database, "SELECT id FROM map"):
        put_facts(database, {})
        yield "the map's facts: which words and weights it was made with"
    sessions = _numbers(database, "SELECT session FROM keyframes EXCEPT SELECT id FROM sessions")
    put(database, "sessions", [(number, UNNAMED, "", 1, "{}") for number in sorted(sessions)])
    if sessions:
        yield f"name and facts of {named('session', sessions)}; keyframes are kept"
    # Nobody can go on from a keyframe without arrays.
    database.execute("DELETE FROM keyframes WHERE id NOT IN (SELECT id FROM keyframe_arrays)")
    asked = f"SELECT id FROM ({' UNION '.join(OWNERS)}) EXCEPT SELECT id FROM keyframes"
    known = {"keyframes": _numbers(database, asked) | damaged["keyframe_arrays"]}
    for table, condition in HOMELESS.items():
        known.setdefault(table, _numbers(database, f"SELECT id FROM {table} WHERE {condition}"))
        database.execute(f"DELETE FROM {table} WHERE {condition}")
    for table in COUNTED:
        yield from _lost(database, table, written.get(table, 0), known.get(table, set()) | damaged[table])
    bare = _numbers(database, "SELECT id FROM edges WHERE has_arrays EXCEPT SELECT id FROM edge_arrays")
    if bare:
        yield f"arrays of {named('edge', bare)}"
    count_anew(database)


def _lost(database: sqlite3.Connection, table: str, written: int, known: set[int]) -> Iterator[str]:
    """What a table has lost: how many of its rows, and which, where that is known."""
    found = _numbers(database, f"SELECT id FROM {table}")
    gone = known - found
    number = max(written - len(found), len(gone))
    if not number:
        return
    holes = set(range(min(found, default=0), max(found, default=0))) - found if len(gone) < number else set()
    gone = gone | holes if len(gone | holes) == number else gone
    words = f"{number} of {len(found) + number} {NAMES[table]}"
    yield f"{words}: {named('number', gone)}" if gone and table in ("keyframes", "edges") else words


def named(kind: str, numbers: Iterable[int]) -> str:
    """Numbers in words: keyframes 3, 5 to 9."""
    ordered = sorted(numbers)
    runs = [[k for _, k in run] for _, run in itertools.groupby(enumerate(ordered), lambda pair: pair[1] - pair[0])]
    words = [str(run[0]) if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs]
    more = [f"and {len(words) - MOST_NAMED} more runs of numbers"] * (len(words) > MOST_NAMED)
    return f"{kind}{'s' * (len(ordered) > 1)} {', '.join([*words[:MOST_NAMED], *more])}"


def _numbers(database: sqlite3.Connection, query: str) -> set[int]:
    return {number for (number,) in database.execute(query)}


def _number(database: sqlite3.Connection, query: str) -> int:
    return database.execute(query).fetchone()[0]
