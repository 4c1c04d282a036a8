"""Indexes an mcap file by walking its records; files without a summary, and cut ones, are walked alike.

A record is a byte that says what it is, its size in 8 bytes, and its content. Chunks are followed by message indexes; a
chunk without them is decompressed and walked itself. No other payload is read.
"""

import struct
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ebjax.io.logs.bag_index import (
    NO_CHUNK,
    Channel,
    Chunk,
    ChunkReader,
    Index,
    Rows,
    Source,
    channel_from,
    chunks_with_unknown,
)

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = 2, 3, 4, 5, 6, 7
MESSAGE_HEAD = 22
ENTRY = np.dtype([("time", "<i8"), ("offset", "<i8")])


class Record(NamedTuple):
    """A record: its kind, and where it and its content are."""

    op: int
    position: int
    start: int
    size: int


def records(reader: ChunkReader, chunk: Chunk | None, start: int, end: int) -> Iterator[Record]:
    """The records from `start` on; the last may go beyond the end."""
    while start + 9 <= end:
        op, size = struct.unpack("<BQ", reader.read(chunk, start, 9))
        if op == 0 or op == MAGIC[0]:
            return
        yield Record(op, start, start + 9, size)
        start += 9 + size


def _text(content: bytes, position: int) -> tuple[str, int]:
    (size,) = struct.unpack_from("<I", content, position)
    return content[position + 4 : position + 4 + size].decode(), position + 4 + size


class McapFile:
    """An mcap file. Opening it reads the heads of its records only; `index` says where its messages are."""

    def __init__(self, source: Source):
        self._source, self._reader = source, ChunkReader(source)
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, Channel] = {}
        self._rows = Rows()
        self._chunks: dict[int, Chunk] = {}
        self.index = self._walk()

    def _describe(self, chunk: Chunk | None, record: Record) -> None:
        content = self._reader.read(chunk, record.start, record.size)
        (number,) = struct.unpack_from("<H", content)
        if record.op == SCHEMA:
            self._schemas[number] = _text(content, 2)[0]
        elif number not in self._channels:
            (schema,) = struct.unpack_from("<H", content, 2)
            topic, position = _text(content, 4)
            encoding, _ = _text(content, position)
            self._channels[number] = channel_from(topic, self._schemas.get(schema, "without schema"), encoding)

    def _message(self, chunk: int, record: Record) -> None:
        head = self._reader.read(self._chunks.get(chunk), record.start, MESSAGE_HEAD)
        number, _, time = struct.unpack_from("<HIQ", head)
        self._rows.add(number, time, chunk, record.position)

    def _scan(self, position: int, *, messages: bool) -> None:
        """Walks the records inside a chunk: schemas, channels, and messages where they are wanted."""
        chunk = self._chunks[position]
        end = len(self._reader.content(chunk)) if chunk.compression else chunk.size
        for record in records(self._reader, chunk, 0, end):
            if record.start + record.size > end:
                return
            if record.op in (SCHEMA, CHANNEL):
                self._describe(chunk, record)
            elif record.op == MESSAGE and messages:
                self._message(position, record)

    def _chunk(self, record: Record) -> None:
        head = self._source.read(record.start, 64)
        compression, position = _text(head, 28)
        (size,) = struct.unpack_from("<Q", head, position)
        start = record.start + position + 8
        size = max(min(size, self._source.size - start), 0)
        self._chunks[record.position] = Chunk(start, size, compression)

    def _index_entries(self, position: int, record: Record) -> None:
        content = self._source.read(record.start, record.size)
        (number,) = struct.unpack_from("<H", content)
        entries = np.frombuffer(content, ENTRY, (len(content) - 6) // ENTRY.itemsize, 6)
        self._rows.add_block(number, entries["time"], position, entries["offset"])

    def _walk(self) -> Index:
        notes, end, is_whole = [], self._source.size, False
        pending: int | None = None
        indexed = False
        for record in records(self._reader, None, len(MAGIC), end):
            is_cut = record.start + record.size > end
            if is_cut and (record.op != CHUNK or end - record.start < 64):
                break
            if record.op != MESSAGE_INDEX and pending is not None:
                if not indexed:
                    self._scan(pending, messages=True)
                pending = None
            if record.op == CHUNK:
                self._chunk(record)
                pending, indexed = record.position, False
            elif record.op == MESSAGE_INDEX and pending is not None:
                self._index_entries(pending, record)
                indexed = True
            elif record.op == MESSAGE:
                self._message(NO_CHUNK, record)
            elif record.op in (SCHEMA, CHANNEL):
                self._describe(None, record)
            is_whole = record.op == FOOTER
        if pending is not None:  # Cut: the index of the last chunk may be missing in part.
            self._rows.forget(pending)
            try:
                self._scan(pending, messages=True)
            except ValueError as error:
                notes.append(f"the last chunk cannot be read: {error}")
        if not is_whole:
            notes.append("the file is cut off or its recorder was killed; what is there is read")
        for chunk in chunks_with_unknown(self._rows.table(), self._channels):
            self._scan(chunk, messages=False)
        return self._rows.index(self._channels, self._chunks, notes)

    def read(self, row: int, limit: int | None) -> bytes:
        """The message of a row of the index, or its first bytes."""
        chunk, position = self._chunks.get(int(self.index.chunk[row])), int(self.index.offset[row])
        op, size = struct.unpack("<BQ", self._reader.read(chunk, position, 9))
        if op != MESSAGE:
            raise ValueError("the file's index points to no message; the file is damaged, copy it again")
        size -= MESSAGE_HEAD
        return self._reader.read(chunk, position + 9 + MESSAGE_HEAD, size if limit is None else min(limit, size))

    def close(self) -> None:
        """Closes the file."""
        self._source.close()
