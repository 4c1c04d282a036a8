"""What a training did, step by step: a log of JSON lines and, if wanted, TensorBoard's event files.

Written by the first process. Where a run is gone on with, what came after that step is taken away first.
"""

import json
import struct
import time
from pathlib import Path
from typing import Any

from ebjax.io.atomic import whole_file
from ebjax.train import processes

LINES, EVENTS = "log.jsonl", "events"


class Log:
    """The log of a training.

    Args:
      out: its folder.
      step: that it begins after.
      events: whether TensorBoard's are written too; needs tensorboardX.

    Raises:
      OSError: nothing can be written there.
    """

    def __init__(self, out: Path, step: int, *, events: bool):
        self._path = out / LINES if processes.first() else None
        self._events = _Events(out / EVENTS, step) if events and processes.first() else None
        if self._path is None:
            return
        kept = []
        if step and self._path.is_file():
            lines = self._path.read_text(encoding="utf-8").splitlines()
            kept = [line for line in lines if line.endswith("}") and json.loads(line)["step"] <= step]
        with whole_file(self._path) as file:
            file.write("".join(f"{line}\n" for line in kept))

    def write(self, step: int, kind: str, metrics: dict[str, float], seconds: float) -> None:
        """Adds a line: kind is "step" or "validation"; raises OSError that names the file."""
        if self._path is None:
            return
        line = {"step": step, "kind": kind, "seconds": round(seconds, 3), **metrics}
        try:
            with open(self._path, "a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
            if self._events is not None:
                self._events.write(step, {f"{kind}/{name}": value for name, value in metrics.items()})
        except OSError as fault:
            raise OSError(fault.errno, fault.strerror, str(self._path)) from None


class _Events:
    """A file of TensorBoard's records, each whole when `write` returns: tensorboardX's own writer may lose the last."""

    def __init__(self, folder: Path, step: int):
        from tensorboardX.proto import event_pb2, summary_pb2
        from tensorboardX.record_writer import masked_crc32c

        self._event, self._summary, self._check = event_pb2.Event, summary_pb2.Summary, masked_crc32c
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / f"events.out.tfevents.{time.time():.6f}.ebjax"
        self._append(self._event(wall_time=time.time(), file_version="brain.Event:2"))
        if step:  # what was written after it no longer counts
            start = event_pb2.SessionLog(status=event_pb2.SessionLog.START)
            self._append(self._event(wall_time=time.time(), step=step + 1, session_log=start))

    def write(self, step: int, scalars: dict[str, float]) -> None:
        values = [self._summary.Value(tag=tag, simple_value=value) for tag, value in scalars.items()]
        self._append(self._event(wall_time=time.time(), step=step, summary=self._summary(value=values)))

    def _append(self, event: Any) -> None:
        content = event.SerializeToString()
        length = struct.pack("<Q", len(content))
        parts = (length, content)
        with open(self._path, "ab") as file:
            file.write(b"".join(part + struct.pack("<I", self._check(part)) for part in parts))
