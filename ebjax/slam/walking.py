"""A run of which only the last keyframes are held: as far as the next step reaches back."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from ebjax.features.landmarks import Landmarks
from ebjax.odometry.steps import Steps
from ebjax.slam.frame import Frame
from ebjax.slam.look import Looked
from ebjax.slam.packed import Arrays
from ebjax.slam.store import Between, InMemory, Shelf
from ebjax.slam.walker import Walker

LAST = 64
"""Keyframes that are held: more than a step reaches back."""


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


class Walking(Walker):
    """Hangs keyframes on the path and lets go of old ones; only numbers stay: 48 bytes a frame, 200 a keyframe."""

    def __init__(self, *given: Any, **options: Any):
        """See `ebjax.slam.mapper.Mapper`; without a store."""
        super().__init__(*given, store=LastKeyframes(), **options)

    def go_on(self, frame: Frame) -> Iterator[tuple[int, Arrays, Steps]]:
        """Takes the next frame; of each new keyframe its row, itself packed, and the steps to earlier ones.

        Raises:
          ValueError: as of `Walker.due`.
        """
        number, due = self.due(frame)
        for one, kept in due:
            row = self._arrived(one, kept)
            self.store.keep(kept)
            self.looked.told.clear()
            yield row, kept, self._steps
        self.passed(frame, number, any(one == number for one, _ in due))
        self.names.clear()
        self._between.clear()

    def keyframe_from_base(self) -> Float[np.ndarray, "3"]:
        """The last frame, seen from the last keyframe."""
        return self._from_keyframe()


class AcrossMap(Looked):
    """The `count` keyframes of a map, and behind them the last ones of a run."""

    def __init__(self, store: Shelf, count: int, walk: Walking):
        turn, config = walk.eyes.extractor.turn, walk.config
        super().__init__(store, walk.view, walk.camera, turn, config.tolerance_m, config.seed)
        self._count, self._walked = count, walk.looked

    def landmarks(self, row: int, facing: bool = False) -> Landmarks:
        """The features of a keyframe."""
        if row < self._count:
            return super().landmarks(row, facing)
        return self._walked.landmarks(row - self._count, facing)
