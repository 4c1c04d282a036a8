"""A run as it comes, in rerun's viewer or recorded into a file (extra viz). It never holds up the run.

rerun draws in a process of its own: its calls wait while a viewer stands still, and at the end for good. Updates that
this process does not take in time are left out, all but their closures; the next path puts the map right.
"""

import contextlib
import importlib.util
import os
import pickle
import queue
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ebjax.slam.frame import Closure, Update
from ebjax.viz.live_scene import Segment, Segments, Shown

WAITING = 64
"""Updates that wait to be drawn, at most."""
PATIENCE_S = 10.0
"""How long the end waits for what is still to be drawn."""


class Live:
    """Shows updates while it is open.

    with Live(save="run.rrd") as live:
        live.show(update, view.floor_from_view)
    """

    def __init__(self, *, spawn: bool = False, save: str | Path | None = None):
        """Opens a viewer, a recording, or both.

        Args:
          spawn: open rerun's viewer.
          save: a file to record into; an existing one is replaced.

        Raises:
          ValueError: rerun is not installed, or there is no screen for a viewer.
          OSError: the file cannot be written.
        """
        if importlib.util.find_spec("rerun") is None:
            raise ValueError('showing or recording a run needs rerun: python -m pip install "ebjax[viz]"')
        if spawn and sys.platform == "linux" and not {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ):
            raise ValueError(
                "no screen to show the run on (DISPLAY is not set); record it with --save-rrd FILE instead"
            )
        self._painters: list[Painter] = []
        self._rows: dict[int, int] = {}
        if save is not None:
            Path(save).parent.mkdir(parents=True, exist_ok=True)
            with open(save, "ab"):  # says what is wrong with it before rerun does
                pass
        targets = [str(save)] if save is not None else []
        try:
            for target in [*targets, None] if spawn else targets:
                self._painters.append(Painter(target))
        except ValueError:
            self.close()
            raise

    def show(self, update: Update, floor_from_view: Float[np.ndarray, "3 3"]) -> None:
        """Hands an update over to be drawn; returns at once.

        Args:
          update: of the engine.
          floor_from_view: of its floor view: pixel (u, v, 1) -> (x, y, 1) in base, m.
        """
        if update.keyframe is not None:
            self._rows[update.frame] = int(update.keyframe)
        shown = Shown(
            float(update.stamp_s),
            int(update.frame),
            None if update.keyframe is None else int(update.keyframe),
            np.array(update.map_from_base, np.float64),
            None if update.path is None else np.array(update.path, np.float64),
            {(one.i, one.j): self._segment(one) for one in update.closures},
            None if update.view is None else np.asarray(update.view),
            np.asarray(floor_from_view, np.float64),
            float(update.milliseconds),
        )
        for painter in self._painters:
            painter.put(shown)

    def _segment(self, closure: Closure) -> Segment:
        way = "opposing" if closure.opposing else "same direction"
        said = f"{closure.i} - {closure.j}, {way}: {closure.reason}"
        rows = self._rows.get(closure.i, -1), self._rows.get(closure.j, -1)
        return Segment(rows, bool(closure.opposing), bool(closure.kept), said)

    def close(self) -> tuple[str, ...]:
        """Draws what waits.

        Returns:
          What was not shown, a line each.
        """
        return tuple(note for painter in self._painters for note in painter.close())

    def __enter__(self) -> "Live":
        return self

    def __exit__(self, *fault: object) -> None:
        for note in self.close():
            print(note, file=sys.stderr)


class Painter:
    """A process that draws, the updates that wait for it, and the thread that hands them over."""

    def __init__(self, save: str | None):
        self.name = "rerun's viewer" if save is None else save
        self.asked = self.left_out = 0
        self.missed: Segments = {}
        code = f"from ebjax.viz.live_scene import serve; serve({save!r})"
        self.process = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self.process.stdin is not None and self.process.stdout is not None
        said = self.process.stdout.readline().decode(errors="replace")
        self.process.stdout.close()
        if said.strip() or not said:
            self.process.kill()
            self.process.wait()
            self.process.stdin.close()
            raise ValueError(f"{self.name}: rerun does not start: {said.strip() or 'it ended at once'}")
        self.waiting: queue.Queue[Shown | None] = queue.Queue(WAITING)
        self.closed = False
        self.thread = threading.Thread(target=self._hand_over, daemon=True)
        self.thread.start()

    def put(self, update: Shown) -> None:
        """Lets an update wait, or leaves it out where too many do; its closures come with the next."""
        self.asked += 1
        if self.missed:
            update = update._replace(closures=self.missed | update.closures)
        try:
            self.waiting.put_nowait(update)
            self.missed = {}
        except queue.Full:
            self.left_out += 1
            self.missed = update.closures

    def close(self) -> tuple[str, ...]:
        """Ends the process: when it has drawn what waits, or by force."""
        if self.closed:
            return ()
        self.closed = True
        try:
            self.waiting.put(None, timeout=PATIENCE_S)
            forced = False
        except queue.Full:
            self.process.kill()
            self.waiting.put(None)  # for `_hand_over`, which now empties the queue
            forced = True
        try:
            self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            forced = True
        code = self.process.wait()
        self.thread.join()
        if forced:
            return (f"{self.name}: stopped, since it took nothing for {PATIENCE_S:g} s; the run itself is complete",)
        if code:
            return (f"{self.name}: was closed, or failed, before the run ended; the run itself is complete",)
        if self.left_out:
            return (f"{self.name}: {self.left_out} of {self.asked} frames were left out, since it did not keep up",)
        return ()

    def _hand_over(self) -> None:
        stream = self.process.stdin
        assert stream is not None
        try:
            while (update := self.waiting.get()) is not None:
                pickle.dump(update, stream, pickle.HIGHEST_PROTOCOL)
                stream.flush()
            stream.close()
        except OSError:  # the process has ended; `close` says so
            with contextlib.suppress(OSError):
                stream.close()
            while self.waiting.get() is not None:
                pass
