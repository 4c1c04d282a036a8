"""Moves what was written from FILE-wal into the file, in a thread: a disk may take long to say that it has it."""

import contextlib
import sqlite3
import threading
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

LOG_BYTES = 1 << 24
"""About 135 keyframes: what a power cut may cost. Smaller ones write pages of the tables more often."""
CHECKPOINT = "PRAGMA wal_checkpoint(PASSIVE)"


class Checkpointer:
    """A thread that is woken as FILE-wal has grown by LOG_BYTES."""

    def __init__(self, path: Path, writing: AbstractContextManager[Any]):
        """Starts the thread; `writing` is held by whoever writes."""
        self._path, self._writing, self._waiting, self._stopped = path, writing, 0, False
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._work, name=f"checkpoints of {path.name}", daemon=True)
        self._thread.start()

    def written(self, size: int) -> None:
        """Counts bytes that were committed."""
        self._waiting += size
        if self._waiting >= LOG_BYTES:
            self._waiting = 0
            self._wake.set()

    def stop(self) -> None:
        """Ends the thread, after the checkpoint in work."""
        self._stopped = True
        self._wake.set()
        self._thread.join()

    def _work(self) -> None:
        with contextlib.closing(sqlite3.connect(f"{self._path.as_uri()}?mode=rw", uri=True)) as database:
            database.execute("PRAGMA synchronous = NORMAL")
            while True:
                self._wake.wait()
                self._wake.clear()
                if self._stopped:
                    return
                # A checkpoint that fails (a full disk) is tried again with the next; FILE-wal holds everything.
                with contextlib.suppress(sqlite3.Error):
                    database.execute(CHECKPOINT).fetchone()
                    # The little that was written meanwhile: only a log that was moved whole begins anew.
                    with self._writing:
                        database.execute(CHECKPOINT).fetchone()
