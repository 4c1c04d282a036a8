"""Indexes a ROS 2 SQLite file (.db3) by its tables of topics and messages; no payload is read."""

import sqlite3
from pathlib import Path
from threading import RLock

from ebjax.io.logs.bag_index import NO_CHUNK, Channel, Index, Rows, channel_from
from ebjax.io.one_line import one_line

MAGIC = b"SQLite format 3\0"


class SqliteFile:
    """A ROS 2 .db3 file, opened for reading only."""

    def __init__(self, path: Path):
        # A write-ahead log beside the file holds messages too; without one, a read-only folder will do.
        has_log = path.with_name(path.name + "-wal").exists()
        name = f"{path.absolute().as_uri()}?mode=ro{'' if has_log else '&immutable=1'}"
        self._base, self._lock = sqlite3.connect(name, uri=True, check_same_thread=False), RLock()
        try:
            self.index = self._index()
        except BaseException:
            self._base.close()
            raise

    def _topics(self) -> dict[int, Channel]:
        try:
            rows = self._base.execute("SELECT id, name, type, serialization_format FROM topics").fetchall()
        except sqlite3.Error as error:
            said = one_line(error)
            raise ValueError(f"an SQLite file without ROS 2 topics ({said}); give a .db3 of rosbag2") from None
        return {
            number: channel_from(topic, kind, str(encoding or "cdr"))
            for number, topic, kind, encoding in rows
            if isinstance(number, int) and isinstance(topic, str) and isinstance(kind, str)
        }

    def _index(self) -> Index:
        channels, rows, notes = self._topics(), Rows(), list[str]()
        try:
            for topic, time, number in self._base.execute("SELECT topic_id, timestamp, id FROM messages"):
                rows.add(topic, time, NO_CHUNK, number)
        except (sqlite3.Error, TypeError, OverflowError) as error:
            notes.append(f"the file is damaged ({one_line(error)}); what is there is read")
        return rows.index(channels, {}, notes)

    def read(self, row: int, limit: int | None) -> bytes:
        """The message of a row of the index, or its first bytes."""
        with self._lock:
            try:
                with self._base.blobopen("messages", "data", int(self.index.offset[row]), readonly=True) as blob:
                    return blob.read() if limit is None else blob.read(min(limit, len(blob)))
            except sqlite3.Error as error:
                said = one_line(error)
                raise ValueError(f"a message cannot be read ({said}); the file is damaged, copy it again") from None

    def close(self) -> None:
        """Closes the file."""
        self._base.close()
