"""A run without its loops: which frames are keyframes, how they look, and the steps between the last of them."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from ebjax.odometry.steps import Steps
from ebjax.slam.frame import Frame, Update
from ebjax.slam.mapper import Mapper
from ebjax.slam.packed import Arrays
from ebjax.slam.store import Between, InMemory

LAST = 64
"""Keyframes that are held: more than a step reaches back."""
Arrived = Callable[[int, Arrays, Steps], None]
"""(row of a new keyframe, packed, what was measured between it and earlier ones)."""


class LastKeyframes(InMemory):
    """The last LAST keyframes, by row."""

    def __init__(self):
        super().__init__()
        self._gone = 0

    def __len__(self) -> int:
        """Returns the number of keyframes, those that are gone included."""
        return self._gone + len(self._kept)

    def arrays(self, row: int) -> Arrays:
        """Those of one of the last keyframes."""
        return self._kept[row - self._gone]

    def keep(self, kept: Arrays, name: str = "", between: Sequence[Between] = ()) -> None:
        """Adds a keyframe and lets go of an old one."""
        super().keep(kept)
        if len(self._kept) > LAST:
            self._gone += 1
            del self._kept[0]


class Walking(Mapper):
    """The engine as far as the path by its steps alone.

    Of what lies behind the last keyframes only numbers stay: 48 bytes a frame and 200 a keyframe.

    Args:
      arrived: is told every keyframe, when its step is on the path.
      engine: what `Mapper` takes.
    """

    def __init__(self, *engine: Any, arrived: Arrived, **options: Any):
        super().__init__(*engine, store=LastKeyframes(), **options)
        self._tell = arrived

    def keyframe_from_base(self) -> Float[np.ndarray, "3"]:
        """The last frame, seen from the last keyframe."""
        return self._from_keyframe()

    def _noted(self, frame: Frame) -> int:
        number = super()._noted(frame)
        self.names.clear()
        return number

    def _keyframe(self, number: int, kept: Arrays):
        row = self._arrived(number, kept)
        self.store.keep(kept)
        self.looked.told.clear()
        self._tell(row, kept, self._steps)
        return (), False

    def _update(self, frame: Frame, number: int, keyframe: bool, closures, path, begun: float) -> Update:
        self._between.clear()
        row = len(self.chain) - 1
        pose = np.zeros(3) if row < 0 else self.chain.poses[row].copy()
        return Update(number, frame.stamp_s, row if keyframe else None, pose, False, None, np.zeros((3, 3)))
