"""How far a running engine is, on stderr: one live line on a terminal, elsewhere a plain line now and then."""

import os
import sys
import time
from collections.abc import Callable

EVERY_S = 5.0
LEAST_S = 1.0
"""A plain line comes after EVERY_S, or after another tenth of the run, but not within LEAST_S of the last."""
COMPILES = "reads its programs, or compiles those it has not kept yet"


class Counts:
    """What both kinds say: counts so far, and means since they said it last."""

    def __init__(self, total: int | None, clock: Callable[[], float]):
        self.total, self.clock = total, clock
        self.done = self.keyframes = self.closures = 0
        self.said_done, self.said_s = 0, clock()
        self.spent_ms: list[float] = []

    def count(self, frame: int, keyframes: int, closures: int, ms: float) -> None:
        """Takes in a frame: its number from 0, keyframes and closures so far, and the milliseconds that it took."""
        if not self.done:  # of a run that is taken up again too
            self.said_done = frame
        self.done, self.keyframes, self.closures = frame + 1, keyframes, closures
        self.spent_ms.append(ms)

    def line(self) -> str:
        """What there is to say now."""
        now = self.clock()
        frames, passed = len(self.spent_ms), now - self.said_s
        each = sum(self.spent_ms) / frames if frames else 0.0
        rate = frames / passed if passed > 0 else 0.0
        self.said_done, self.said_s, self.spent_ms = self.done, now, []
        return f"{self.keyframes:,} keyframes, {self.closures:,} closures, {each:.0f} ms a frame, {rate:.1f} frames/s"


class PlainLines(Counts):
    """Lines in a log file."""

    def update(self, frame: int, keyframes: int, closures: int, ms: float) -> None:
        """After a frame, as `count`."""
        self.count(frame, keyframes, closures, ms)
        passed = self.clock() - self.said_s
        tenth = self.total and 10 * self.said_done // self.total < 10 * self.done // self.total
        if passed >= EVERY_S or (tenth and passed >= LEAST_S):
            self._write()

    def __enter__(self) -> "PlainLines":
        if self.total:
            print(f"frame 0 of {self.total:,}: waits while JAX {COMPILES}", file=sys.stderr, flush=True)
        return self

    def __exit__(self, *fault: object) -> None:
        if self.spent_ms:
            self._write()

    def _write(self) -> None:
        of = f" of {self.total:,} ({self.done / self.total:.0%})" if self.total else ""
        print(f"frame {self.done:,}{of}: {self.line()}", file=sys.stderr, flush=True)


class LiveLine(Counts):
    """A bar on a terminal, which is gone when the run has ended."""

    def __init__(self, total: int | None, clock: Callable[[], float]):
        super().__init__(total, clock)
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (TextColumn("{task.description}"), BarColumn(20), MofNCompleteColumn(), TimeRemainingColumn())
        self.progress = Progress(*columns, console=Console(stderr=True), transient=True, refresh_per_second=4)
        self.task = self.progress.add_task(f"JAX {COMPILES}", total=total)

    def update(self, frame: int, keyframes: int, closures: int, ms: float) -> None:
        """After a frame, as `count`."""
        self.count(frame, keyframes, closures, ms)
        if self.clock() - self.said_s >= LEAST_S:
            self.progress.update(self.task, description=self.line())
        self.progress.update(self.task, completed=self.done)

    def __enter__(self) -> "LiveLine":
        self.progress.start()
        return self

    def __exit__(self, *fault: object) -> None:
        self.progress.stop()


def ticker(total: int | None, *, clock: Callable[[], float] = time.monotonic) -> PlainLines | LiveLine:
    """Opens what says how far a run is; enter it, and call its `update` after every frame.

    Args:
      total: frames of the run; None where that is not known.
      clock: gives seconds.
    """
    live = sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
    return LiveLine(total, clock) if live else PlainLines(total, clock)
