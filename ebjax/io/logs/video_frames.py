"""Random access to a video's frames, found by their times: one frame in memory, safe with several threads."""

import math
import threading
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, UInt8

from ebjax.io.logs.video_source import Source

SAME_S = 1e-6
FAR_AHEAD = 150
STEPS_BACK_S = (1.0, 8.0, 64.0)
BEFORE, BEHIND = -math.inf, math.inf


class VideoFrames:
    """The frames of a video by index.

    It goes on from frame to frame, and jumps to some seconds before a frame that lies behind or far ahead. Where a jump
    ended is known by the time of the next frame alone. A video that cannot jump is decoded from its start.
    """

    def __init__(self, open_source: Callable[[], Source], times_s: Float[np.ndarray, " N"], counted: bool):
        """Opens nothing yet.

        Args:
          open_source: opens the video at its start.
          times_s: of the frames, as the source gives them, increasing.
          counted: the source's times do not tell frames apart, so frames are counted from the start.
        """
        self._open = open_source
        self._times = np.arange(len(times_s), dtype=np.float64) if counted else times_s
        self._counted = counted
        self._lock = threading.Lock()
        self._can_jump = not counted
        self._source: Source | None = None
        self._at = BEFORE

    def read(self, index: int) -> UInt8[np.ndarray, "H W 3"] | None:
        """Returns a frame, RGB; None if it cannot be decoded."""
        with self._lock:
            source = self._source or self._restart()
            time = float(self._times[index])
            if abs(self._at - time) <= SAME_S or self._go_on(source, time) or self._jump(source, time):
                return source.image()
            source = self._restart()
            return source.image() if self._grab_until(source, time) else None

    def _restart(self) -> Source:
        self._source, self._at = self._open(), BEFORE
        return self._source

    def _go_on(self, source: Source, time: float) -> bool:
        """Grabs on to a frame that lies ahead, if it is near or can be reached in no other way."""
        if time < self._at:
            return False
        first, last = np.searchsorted(self._times, [self._at, time])
        return (last - first <= FAR_AHEAD or not self._can_jump) and self._grab_until(source, time)

    def _jump(self, source: Source, time: float) -> bool:
        """Jumps to before a frame, then grabs on to it; a video where that never leads there is not asked again."""
        for back_s in STEPS_BACK_S if self._can_jump else ():
            if time - back_s <= self._times[0]:
                return False
            source.seek(time - back_s)
            if self._grab(source) < time - SAME_S and self._grab_until(source, time):
                return True
        self._can_jump = False
        return False

    def _grab(self, source: Source) -> float:
        time = source.grab()
        if time is None:
            self._at = BEHIND
        elif self._counted:
            self._at = 0.0 if self._at == BEFORE else self._at + 1
        else:
            self._at = time
        return self._at

    def _grab_until(self, source: Source, time: float) -> bool:
        """Grabs until the frame of a time; False where that is passed, or the video ends."""
        while self._grab(source) < time - SAME_S:
            pass
        return self._at <= time + SAME_S
