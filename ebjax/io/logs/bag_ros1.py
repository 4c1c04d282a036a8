"""Indexes a ROS 1 bag (format 2.0) by walking its records; whole, unindexed and cut files are walked alike.

A record is a header (fields `name=value`, the field `op` says what it is) and data. Chunks hold messages and are
followed by their index; a chunk without one is decompressed and walked itself. No other payload is read.
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

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
ENTRY = np.dtype([("sec", "<u4"), ("nsec", "<u4"), ("offset", "<u4")])
HEAD = 256


class Record(NamedTuple):
    """A record: its kind, its header's fields, and where its data is."""

    op: int
    fields: dict[bytes, bytes]
    position: int
    start: int
    size: int


def fields_from(header: bytes) -> dict[bytes, bytes]:
    """The fields of a header."""
    fields, position = {}, 0
    while position + 4 <= len(header):
        (size,) = struct.unpack_from("<I", header, position)
        name, _, value = header[position + 4 : position + 4 + size].partition(b"=")
        fields[name], position = value, position + 4 + size
    return fields


def record_at(reader: ChunkReader, chunk: Chunk | None, position: int) -> Record | None:
    """The record at a position of a chunk or of the file; None where there is none."""
    head = reader.read(chunk, position, HEAD)
    if len(head) < 8:
        return None
    (size,) = struct.unpack_from("<I", head)
    if size + 8 > len(head):
        if size > 1 << 20:
            return None
        head = reader.read(chunk, position, size + 8)
        if len(head) < size + 8:
            return None
    fields = fields_from(head[4 : 4 + size])
    if len(fields.get(b"op", b"")) != 1:
        return None
    (data,) = struct.unpack_from("<I", head, 4 + size)
    return Record(fields[b"op"][0], fields, position, position + size + 8, data)


def records(reader: ChunkReader, chunk: Chunk | None, start: int, end: int) -> Iterator[Record]:
    """The records from `start` on; the last may go beyond the end."""
    while start < end and (record := record_at(reader, chunk, start)) is not None:
        yield record
        start = record.start + record.size


class Ros1File:
    """A ROS 1 bag. Opening it reads the heads of its records only; `index` says where its messages are."""

    def __init__(self, source: Source):
        self._source, self._reader = source, ChunkReader(source)
        self._channels: dict[int, Channel] = {}
        self._rows = Rows()
        self._chunks: dict[int, Chunk] = {}
        self.index = self._walk()

    def _connection(self, chunk: Chunk | None, record: Record) -> None:
        number = int.from_bytes(record.fields[b"conn"], "little")
        described = fields_from(self._reader.read(chunk, record.start, record.size))
        topic, kind = record.fields.get(b"topic", b"").decode(), described.get(b"type", b"").decode()
        self._channels.setdefault(number, channel_from(topic, kind, "ros1"))

    def _message(self, chunk: int, record: Record) -> None:
        sec, nsec = struct.unpack("<II", record.fields[b"time"])
        number = int.from_bytes(record.fields[b"conn"], "little")
        self._rows.add(number, sec * 10**9 + nsec, chunk, record.position)

    def _scan(self, position: int, *, messages: bool) -> None:
        """Walks the records inside a chunk: connections, and messages where they are wanted."""
        chunk = self._chunks[position]
        end = len(self._reader.content(chunk)) if chunk.compression else chunk.size
        for record in records(self._reader, chunk, 0, end):
            if record.start + record.size > end:
                return
            if record.op == CONNECTION:
                self._connection(chunk, record)
            elif record.op == MESSAGE and messages:
                self._message(position, record)

    def _index_entries(self, position: int, record: Record) -> None:
        number = int.from_bytes(record.fields[b"conn"], "little")
        content = self._source.read(record.start, record.size)
        entries = np.frombuffer(content, ENTRY, len(content) // ENTRY.itemsize)
        times = entries["sec"].astype(np.int64) * 10**9 + entries["nsec"]
        self._rows.add_block(number, times, position, entries["offset"])

    def _walk(self) -> Index:
        notes, position, end = [], len(MAGIC), self._source.size
        pending: int | None = None
        indexed = is_whole = False
        for record in records(self._reader, None, position, end):
            position = record.start + record.size
            if position > end and record.op != CHUNK:
                break
            if record.op == BAG_HEADER and record.fields.get(b"encryptor"):
                raise ValueError("an encrypted bag; decrypt it first")
            if record.op in (CHUNK, CONNECTION, CHUNK_INFO, MESSAGE):
                if pending is not None and not indexed:
                    self._scan(pending, messages=True)
                pending, is_whole = None, record.op in (CONNECTION, CHUNK_INFO)
            if record.op == CHUNK:
                size = min(record.size, end - record.start)
                compression = record.fields.get(b"compression", b"none").decode()
                self._chunks[record.position] = Chunk(record.start, size, "" if compression == "none" else compression)
                pending, indexed = record.position, False
            elif record.op == INDEX and pending is not None:
                self._index_entries(pending, record)
                indexed = True
            elif record.op == MESSAGE:
                self._message(NO_CHUNK, record)
            elif record.op == CONNECTION:
                self._connection(None, record)
        if pending is not None:  # Cut: the index of the last chunk may be missing in part.
            self._rows.forget(pending)
            try:
                self._scan(pending, messages=True)
            except ValueError as error:
                notes.append(f"the last chunk cannot be read: {error}")
        if position != end or not (is_whole or not self._chunks):
            notes.append("the bag is cut off or its recorder was killed; what is there is read")
        for chunk in chunks_with_unknown(self._rows.table(), self._channels):
            self._scan(chunk, messages=False)
        return self._rows.index(self._channels, self._chunks, notes)

    def read(self, row: int, limit: int | None) -> bytes:
        """The message of a row of the index, or its first bytes."""
        chunk = self._chunks.get(int(self.index.chunk[row]))
        position = int(self.index.offset[row])
        while (record := record_at(self._reader, chunk, position)) is not None and record.op == CONNECTION:
            position = record.start + record.size
        if record is None or record.op != MESSAGE:
            raise ValueError("the bag's index points to no message; the file is damaged, copy it again")
        return self._reader.read(chunk, record.start, record.size if limit is None else min(limit, record.size))

    def close(self) -> None:
        """Closes the file."""
        self._source.close()
