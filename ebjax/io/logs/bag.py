"""A ROS bag: one file or a folder of splits; ROS 1 .bag, ROS 2 .db3 and .mcap, as they are or zstd-compressed.

Opening reads where the messages are, not the messages, so that memory does not grow with their payloads.
"""

import shutil
import struct
import tempfile
import weakref
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from jaxtyping import Int64

from ebjax.io.logs import bag_mcap, bag_ros1, bag_sqlite
from ebjax.io.logs.bag_index import EXTRA, ZSTD, BagFile, Channel, Source, decompress, zstd_module
from ebjax.io.one_line import one_line
from ebjax.io.text import read_text
from ebjax.io.yaml_text import parse_yaml

SUFFIXES = (".bag", ".db3", ".mcap", ".zstd", ".active")
RECORD_FILES = (
    (bag_ros1.MAGIC, "ROS 1 bag", bag_ros1.Ros1File),
    (bag_mcap.MAGIC, "ROS 2 bag (mcap)", bag_mcap.McapFile),
)
MUST_BE = "give a ROS 1 .bag, a ROS 2 .db3 or .mcap, or the folder that holds them"


@dataclass(frozen=True)
class Bag:
    """Every message of a bag, by row; rows are in file order.

    Attributes:
      path: of the file or folder.
      kind: in words.
      channels: topics with one type each.
      channel: of each row, an index into `channels`.
      time_ns: when each row was received.
      files: the bag's files.
      file: of each row.
      row: of each row, in its file's index.
      notes: what was cut off, a line each.
    """

    path: Path
    kind: str
    channels: tuple[Channel, ...]
    channel: Int64[np.ndarray, " N"]
    time_ns: Int64[np.ndarray, " N"]
    files: tuple[BagFile, ...]
    file: Int64[np.ndarray, " N"]
    row: Int64[np.ndarray, " N"]
    notes: tuple[str, ...]

    def read(self, row: int, limit: int | None = None) -> bytes:
        """The message of a row, or at least its first `limit` bytes.

        Raises:
          ValueError: the message cannot be read; names the file's topic.
        """
        try:
            content = self.files[self.file[row]].read(int(self.row[row]), limit)
            if content[:4] != ZSTD:
                return content
            if limit is None:
                return decompress(content, "zstd")
            return decompress(self.files[self.file[row]].read(int(self.row[row]), None), "zstd", limit)
        except (ValueError, struct.error) as error:
            raise ValueError(f"{self.path}: {self.channels[self.channel[row]].topic}: {error}") from None

    def rows(self, channel: int) -> Int64[np.ndarray, " M"]:
        """The rows of a channel."""
        return np.flatnonzero(self.channel == channel)

    def count(self, channel: int) -> int:
        """How many messages a channel has."""
        return int(np.count_nonzero(self.channel == channel))

    def scan(self, limits: Mapping[int, int | None]) -> Iterator[tuple[int, int, bytes]]:
        """Reads messages of some channels in file order, so that each chunk is decompressed once.

        Args:
          limits: channel -> how many bytes of each message are needed; None is all.

        Yields:
          Channel, row, bytes; none of a message that cannot be read.
        """
        for row in np.flatnonzero(np.isin(self.channel, list(limits))).tolist():
            channel = int(self.channel[row])
            try:
                content = self.read(row, limits[channel])
            except ValueError:
                content = b""
            yield channel, row, content

    def contents(self) -> tuple[str, ...]:
        """A line for each topic: name, type, how many messages."""
        lines = [(c.topic, f"{c.topic}  {c.type}  {self.count(k)} messages") for k, c in enumerate(self.channels)]
        return tuple(line for _, line in sorted(lines))


def _split_paths(folder: Path) -> list[Path]:
    described = folder / "metadata.yaml"
    if described.is_file():
        try:
            names = parse_yaml(read_text(described))["rosbag2_bagfile_information"]["relative_file_paths"]
            paths = [folder / Path(name).name for name in names]
        except (yaml.YAMLError, KeyError, TypeError, ValueError):
            paths = []
        if paths and all(path.is_file() for path in paths):
            return paths
    return sorted((p for p in folder.iterdir() if p.suffix in SUFFIXES and p.is_file()), key=_split_key)


def _split_key(path: Path) -> tuple[str, int, str]:
    """Sorts run_2.db3 before run_10.db3."""
    stem, _, number = path.name.split(".")[0].rpartition("_")
    return (stem, int(number), path.name) if number.isdigit() else (path.name, -1, path.name)


def _unpacked(path: Path) -> tuple[Path, tempfile.TemporaryDirectory]:
    folder = tempfile.TemporaryDirectory(prefix="ebjax_bag_")
    target = Path(folder.name) / path.stem
    try:
        with zstd_module().open(path, "rb") as packed, target.open("wb") as file:
            shutil.copyfileobj(packed, file, 1 << 20)
    except Exception as error:
        folder.cleanup()
        if isinstance(error, ImportError):
            raise ValueError(f"{path}: needs {error.name}: {EXTRA}") from None
        raise ValueError(f"{path}: damaged zstd file ({one_line(error)})") from None
    return target, folder


def _walked(path: Path, reader: Callable[[Source], BagFile]) -> BagFile:
    source = Source(path)
    try:
        return reader(source)
    except (KeyError, IndexError, OverflowError, UnicodeDecodeError, struct.error) as error:
        source.close()
        raise ValueError(f"a damaged record ({one_line(error)}); copy the file again") from None
    except BaseException:
        source.close()
        raise


def _open_file(path: Path) -> tuple[BagFile, str, tempfile.TemporaryDirectory | None]:
    with path.open("rb") as file:
        magic = file.read(16)
    if not magic:
        raise ValueError(f"{path}: the file is empty; {MUST_BE}")
    if magic[:4] == ZSTD:
        target, folder = _unpacked(path)
        try:
            opened, kind, _ = _open_file(target)
        except ValueError as error:
            folder.cleanup()
            raise ValueError(str(error).replace(str(target), str(path))) from None
        return opened, kind, folder
    try:
        if magic == bag_sqlite.MAGIC:
            return bag_sqlite.SqliteFile(path), "ROS 2 bag (sqlite3)", None
        for start, kind, reader in RECORD_FILES:
            if magic.startswith(start):
                return _walked(path, reader), kind, None
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    if magic.startswith(b"#ROSBAG"):
        raise ValueError(f"{path}: an old bag format; run `rosbag migrate`")
    raise ValueError(f"{path}: not a ROS bag; {MUST_BE}")


def open_files(path: str | Path) -> Bag:
    """Opens a bag's files and joins their indexes.

    Raises:
      ValueError: no such file, or not a bag; names it.
    """
    path = Path(path)
    if not path.exists():
        raise ValueError(f"{path}: no such file; {MUST_BE}")
    paths = _split_paths(path) if path.is_dir() else [path]
    if not paths:
        raise ValueError(f"{path}: no bag in the folder; {MUST_BE}")
    opened = [_open_file(part) for part in paths]
    files, channels = tuple(file for file, _, _ in opened), dict[Channel, int]()
    channel, notes = [], []
    for part, file in zip(paths, files, strict=True):
        places = {number: channels.setdefault(c, len(channels)) for number, c in file.index.channels.items()}
        numbers, inverse = np.unique(file.index.channel, return_inverse=True)
        channel.append(np.array([places[n] for n in numbers.tolist()], np.int64)[inverse])
        notes += [f"{part}: {note}" for note in file.index.notes]
    bag = Bag(
        path=path,
        kind=opened[0][1],
        channels=tuple(channels),
        channel=np.concatenate(channel),
        time_ns=np.concatenate([file.index.time_ns for file in files]),
        files=files,
        file=np.repeat(np.arange(len(files)), [len(file.index.channel) for file in files]),
        row=np.concatenate([np.arange(len(file.index.channel)) for file in files]),
        notes=tuple(notes),
    )
    for file, _, folder in opened:
        weakref.finalize(bag, _close, file, folder)
    return bag


def _close(file: BagFile, folder: tempfile.TemporaryDirectory | None) -> None:
    file.close()
    if folder is not None:
        folder.cleanup()
