"""Rows of a damaged map, read from SQLite's pages one by one: no page is needed to find another.

The format is SQLite's (sqlite.org/fileformat2.html): leaves of tables begin with the byte 13 and list their cells; what
of a cell does not fit lies in a chain of overflow pages. A row is taken where its checksum holds for a table of a map.
"""

import contextlib
import mmap
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ebjax.io.map_file.schema import PAGE_BYTES, TABLES, checksum

LEAF = 13
MOST_BYTES = 10**9
"""SQLite's own limit of a row."""
LOG_MAGIC = (0x377F0682, 0x377F0683)
WIDTH = {0: 0, 1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 7: 8, 8: 0, 9: 0}


@dataclass(frozen=True)
class Found:
    """A row; `row` is None where its bytes are damaged, and `table` the only one that has rows of this form."""

    table: str
    id: int
    row: tuple | None


class Pages:
    """The pages of a file, those of a log that were committed in their place."""

    def __init__(self, path: Path, log: Path):
        self._file, self._log = _mapped(path), _mapped(log)
        size = int.from_bytes(self._file[16:18], "big")
        size = 65536 if size == 1 else size
        self.size = size if 512 <= size <= 65536 and not size & (size - 1) else PAGE_BYTES
        self._logged = dict(_committed(self._log, self.size))
        self.count = max([len(self._file) // self.size, *self._logged])

    def __getitem__(self, number: int) -> memoryview:
        """A page by its number, from 1 on; empty where it is cut off."""
        if number in self._logged:
            start = self._logged[number]
            return memoryview(self._log)[start : start + self.size]
        if not 1 <= number <= self.count:
            return memoryview(b"")
        page = memoryview(self._file)[(number - 1) * self.size : number * self.size]
        return page if len(page) == self.size else memoryview(b"")

    def leaves(self) -> list[int]:
        """The numbers of pages that may be leaves of tables and are in use."""
        kinds = np.frombuffer(self._file, np.uint8, len(self._file) // self.size * self.size)[:: self.size]
        numbers = {int(k) + 1 for k in np.flatnonzero(kinds == LEAF)} - self._logged.keys()
        numbers |= {number for number in self._logged if self[number][0] == LEAF}
        return sorted(numbers - self._free())

    def _free(self) -> set[int]:
        """Pages that no longer are in use, as far as their list is whole; they hold rows that were removed."""
        first, free = bytes(self[1][32:36]), set[int]()
        trunk = int.from_bytes(first, "big")
        while 1 < trunk <= self.count and trunk not in free and len(self[trunk]):
            free.add(trunk)
            page = self[trunk]
            following, listed = struct.unpack_from(">II", page)
            if listed > self.size // 4 - 2:
                break
            free |= set(struct.unpack_from(f">{listed}I", page, 8))
            trunk = following
        return free


def found_rows(pages: Pages) -> Iterator[Found]:
    """Every row of a map in the pages, and those that are damaged but have a number."""
    for number in pages.leaves():
        page = pages[number]
        (cells,) = struct.unpack_from(">H", page, 3)
        for (start,) in struct.iter_unpack(">H", page[8 : 8 + 2 * min(cells, (pages.size - 8) // 2)]):
            try:
                yield from _row(pages, page, start)
            except (IndexError, ValueError, struct.error):
                continue


def _row(pages: Pages, page: memoryview, start: int) -> Iterator[Found]:
    size, start = _varint(page, start)
    identity, start = _varint(page, start)
    record = _payload(pages, page, start, size)
    end, at = _varint(record, 0)
    kinds, width = [], 0
    while at < end:
        kind, at = _varint(record, at)
        kinds.append(kind)
        width += WIDTH[kind] if kind in WIDTH else (kind - 12) // 2
    tables = [table for table, columns in TABLES.items() if len(columns) + 2 == len(kinds)]
    if not tables or kinds[0] != 0 or width > size:
        return
    with contextlib.suppress(UnicodeDecodeError):
        values = tuple(_values(record, end, kinds))
        for table in tables:
            row = (identity, *map(_stored, TABLES[table], values[1:-1]))
            if checksum(table, row) == values[-1]:
                yield Found(table, identity, row)
                return
    fitting = [table for table in tables if all(map(_fits, TABLES[table], kinds[1:-1]))]
    if len(fitting) == 1:
        yield Found(fitting[0], identity, None)


def _stored(column: str, value: int | float | str | bytes | None) -> int | float | str | bytes | None:
    """What SQLite gives for a value: in a column of floats it keeps 5.0 as 5."""
    return float(value) if isinstance(value, int) and column.endswith("REAL") else value


def _fits(column: str, kind: int) -> bool:
    """Whether a value of a serial type may stand in a column."""
    declared = column.split()[1]
    if declared == "BLOB":
        return kind >= 12 and kind % 2 == 0
    if declared == "TEXT":
        return kind >= 13 and kind % 2 == 1
    return kind in WIDTH and (declared == "REAL" or kind not in (0, 7))


def _payload(pages: Pages, page: memoryview, start: int, size: int) -> memoryview:
    usable = pages.size
    local = size
    if not 0 < size <= min(pages.count * usable, MOST_BYTES):
        raise ValueError(size)
    if size > usable - 35:
        least = (usable - 12) * 32 // 255 - 23
        local = least + (size - least) % (usable - 4)
        local = local if local <= usable - 35 else least
    if local == size:
        return page[start : start + size]
    content = bytearray(page[start : start + local])
    (following,) = struct.unpack_from(">I", page, start + local)
    while len(content) < size:
        overflow = pages[following]
        if not len(overflow):
            content += bytes(size - len(content))  # cut off: the checksum will say so
            break
        (following,) = struct.unpack_from(">I", overflow)
        content += overflow[4 : 4 + min(usable - 4, size - len(content))]
    return memoryview(bytes(content))


def _values(record: memoryview, at: int, kinds: list[int]) -> Iterator[int | float | str | bytes | None]:
    for kind in kinds:
        width = WIDTH[kind] if kind in WIDTH else (kind - 12) // 2
        content = bytes(record[at : at + width])
        at += width
        if kind >= 12:
            yield content if kind % 2 == 0 else content.decode()
        elif kind == 7:
            yield struct.unpack(">d", content)[0]
        else:
            yield None if kind == 0 else kind - 8 if kind >= 8 else int.from_bytes(content, "big", signed=True)


def _varint(content: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for k in range(9):
        byte = content[at + k]
        value = value << 8 | byte if k == 8 else value << 7 | byte & 127
        if k == 8 or byte < 128:
            return value - (1 << 64) * (value >> 63), at + k + 1
    raise ValueError


def _committed(log: bytes | mmap.mmap, size: int) -> Iterator[tuple[int, int]]:
    """The pages of committed transactions in a write-ahead log: number and start of the last copy."""
    if (
        len(log) < 32
        or struct.unpack_from(">I", log)[0] not in LOG_MAGIC
        or struct.unpack_from(">I", log, 8)[0] != size
    ):
        return
    salt, pending = log[16:24], list[tuple[int, int]]()
    for start in range(32, len(log) - size - 23, size + 24):
        number, pages = struct.unpack_from(">II", log, start)
        if log[start + 8 : start + 16] != salt:
            return
        pending.append((number, start + 24))
        if pages:
            yield from pending
            pending.clear()


def _mapped(path: Path) -> bytes | mmap.mmap:
    if not path.is_file() or not path.stat().st_size:
        return b""
    with open(path, "rb") as file:
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
