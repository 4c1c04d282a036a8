"""Where each message of a bag file is, and how its bytes are read: what the ROS 1, mcap and SQLite readers share."""

import bz2
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from threading import RLock
from types import ModuleType
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Int64

from ebjax.io.one_line import one_line, printable

EXTRA = 'pip install "ebjax[bags]"'
ZSTD = b"\x28\xb5\x2f\xfd"
NO_CHUNK = -1
MOST_BYTES = 1 << 29
"""Of one chunk or message unpacked; recorders make chunks of a few MB."""


@dataclass(frozen=True)
class Channel:
    """A topic of one message type.

    Attributes:
      topic: with its leading slash.
      type: as "sensor_msgs/Image", whichever way the file writes it.
      encoding: "cdr" or "ros1"; another one is not read.
    """

    topic: str
    type: str
    encoding: str


@dataclass(frozen=True)
class Chunk:
    """Stored bytes that hold messages: `size` bytes from `start` on, compressed as `compression` says ("" is not)."""

    start: int
    size: int
    compression: str


@dataclass(frozen=True)
class Index:
    """The messages of one file, in file order.

    Attributes:
      channels: by their numbers in the file.
      channel: its number.
      time_ns: when it was received.
      chunk: file position of its chunk; NO_CHUNK where it lies in no chunk.
      offset: of its record in the chunk's bytes, or in the file; the row's id in SQLite.
      chunks: by file position.
      notes: what was cut off or unreadable, a line each.
    """

    channels: dict[int, Channel]
    channel: Int64[np.ndarray, " N"]
    time_ns: Int64[np.ndarray, " N"]
    chunk: Int64[np.ndarray, " N"]
    offset: Int64[np.ndarray, " N"]
    chunks: dict[int, Chunk]
    notes: tuple[str, ...] = ()


@runtime_checkable
class BagFile(Protocol):
    """One file of a bag."""

    index: Index

    def read(self, row: int, limit: int | None) -> bytes:
        """The message of a row of the index, or its first `limit` bytes."""
        ...

    def close(self) -> None:
        """Closes the file."""
        ...


def channel_from(topic: str, kind: str, encoding: str) -> Channel:
    """Writes a topic and a type in one way: "/camera/image", "sensor_msgs/Image"."""
    return Channel(topic_name(printable(topic)), printable(kind).replace("/msg/", "/"), encoding)


def topic_name(topic: str) -> str:
    """A topic with one leading slash."""
    return "/" + "/".join(part for part in topic.split("/") if part)


class Rows:
    """Collects (channel, time_ns, chunk, offset) of messages: single ones, and blocks of one chunk's index."""

    def __init__(self) -> None:
        self._single, self._blocks = array("q"), list[np.ndarray]()

    def add(self, channel: int, time_ns: int, chunk: int, offset: int) -> None:
        """Adds one message."""
        self._single.extend(array("q", (channel, time_ns, chunk, offset)))

    def add_block(self, channel: int, time_ns: np.ndarray, chunk: int, offset: np.ndarray) -> None:
        """Adds messages of one channel in one chunk."""
        rows = np.empty((len(time_ns), 4), np.int64)
        rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3] = channel, time_ns, chunk, offset
        self._blocks.append(rows)

    def forget(self, chunk: int) -> None:
        """Drops the blocks of the chunk that was added last."""
        while self._blocks and (not len(self._blocks[-1]) or self._blocks[-1][0, 2] == chunk):
            self._blocks.pop()

    def table(self) -> Int64[np.ndarray, "N 4"]:
        """All of them."""
        single = np.frombuffer(self._single, np.int64) if self._single else np.zeros(0, np.int64)
        return np.concatenate([single.reshape(-1, 4), *self._blocks])

    def index(self, channels: dict[int, Channel], chunks: dict[int, Chunk], notes: Sequence[str]) -> Index:
        """All of them in file order, without those of channels that the file does not describe."""
        table = self.table()
        known = np.isin(table[:, 0], list(channels))
        notes = [*notes, *([f"{(~known).sum()} messages of unknown topics are left out"] if not known.all() else [])]
        table = table[known]
        table = table[np.lexsort((table[:, 3], table[:, 2]))]
        columns = [np.ascontiguousarray(column) for column in table.T]
        return Index(channels, columns[0], columns[1], columns[2], columns[3], chunks, tuple(notes))


def chunks_with_unknown(table: Int64[np.ndarray, "N 4"], channels: dict[int, Channel]) -> list[int]:
    """The chunks in which channels first occur that are not described yet: their descriptions are in there."""
    table = table[(table[:, 2] != NO_CHUNK) & ~np.isin(table[:, 0], list(channels))]
    table = table[np.argsort(table[:, 2], kind="stable")]
    _, first = np.unique(table[:, 0], return_index=True)
    return sorted(set(table[first, 2].tolist()))


class Source:
    """A file that is read at positions, by several threads."""

    def __init__(self, path: Path):
        self.path, self._file, self._lock = path, path.open("rb"), RLock()
        self.size = path.stat().st_size

    def read(self, position: int, size: int) -> bytes:
        """At most `size` bytes from `position` on; fewer at the end of the file."""
        size = min(size, self.size - position)
        if position < 0 or size <= 0:
            return b""
        with self._lock:
            self._file.seek(position)
            return self._file.read(size)

    def close(self) -> None:
        """Closes the file."""
        self._file.close()


def decompress(content: bytes, compression: str, limit: int = -1) -> bytes:
    """Decompresses as far as the bytes go, a cut chunk too.

    Raises:
      ValueError: an unknown compression, damaged bytes, more than MOST_BYTES of them, or a package is missing.
    """
    most = MOST_BYTES if limit < 0 else limit
    unpacked = _decompressed(content, compression, most)
    if limit < 0 and len(unpacked) >= MOST_BYTES:
        raise ValueError(f"a damaged {compression} chunk (it unpacks to more than {MOST_BYTES >> 20} MB)")
    return unpacked


def _decompressed(content: bytes, compression: str, most: int) -> bytes:
    try:
        if compression == "bz2":
            return bz2.BZ2Decompressor().decompress(content, most)
        if compression == "lz4":
            from lz4.frame import LZ4FrameDecompressor

            return LZ4FrameDecompressor().decompress(content, most)
        if compression == "zstd":
            return zstd_module().ZstdDecompressor().decompress(content, most)
    except ImportError as error:
        raise ValueError(f"chunks compressed with {compression} need {error.name}: {EXTRA}") from None
    except Exception as error:
        raise ValueError(f"a damaged {compression} chunk ({one_line(error)})") from None
    raise ValueError(f"chunks compressed with {compression!r} are not known; record without compression, or with lz4")


def zstd_module() -> ModuleType:
    """Python's own zstd, or its backport."""
    try:
        return import_module("compression.zstd")
    except ImportError:
        return import_module("backports.zstd")


class ChunkReader:
    """Reads from chunks, and keeps the last two that it had to decompress."""

    KEPT = 2

    def __init__(self, source: Source):
        self._source, self._kept, self._lock = source, dict[int, bytes](), RLock()

    def read(self, chunk: Chunk | None, offset: int, size: int) -> bytes:
        """At most `size` bytes at an offset of a chunk, or of the file."""
        if chunk is None:
            return self._source.read(offset, size)
        if not chunk.compression:
            return self._source.read(chunk.start + offset, max(min(size, chunk.size - offset), 0))
        return self.content(chunk)[offset : offset + size]

    def content(self, chunk: Chunk) -> bytes:
        """All of a chunk, decompressed."""
        if not chunk.compression:
            return self._source.read(chunk.start, chunk.size)
        with self._lock:
            content = self._kept.pop(chunk.start, None)
            if content is None:
                content = decompress(self._source.read(chunk.start, chunk.size), chunk.compression)
            self._kept[chunk.start] = content
            while len(self._kept) > self.KEPT:
                del self._kept[next(iter(self._kept))]
            return content
