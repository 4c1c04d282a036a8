"""Whether the path broke: the robot was carried away, or its odometry began anew, while no image showed it.

A step that nothing but wheels measured puts the path in doubt, until a view that overlaps with one before that step
shows that it held, or a closure says what the path says. A person who walks by is not called a break at once.
"""

import numpy as np
from jaxtyping import Float

from ebjax.odometry.steps import Steps

PATIENCE = 3
"""A path in doubt is given up at the third keyframe."""
FASTER = 3.0
"""A step that wheels alone count, longer than the view and so many times faster than any of the last, is none."""


class Doubt:
    """Rows of the first and the last step that nothing measured, where the path is in doubt.

    Args:
      extent_m: length of the floor view.
    """

    def __init__(self, extent_m: float):
        self._extent_m, self._rows, self._counted = extent_m, (-1, -1), False

    def __bool__(self) -> bool:
        """Whether the path is in doubt."""
        return self._rows[0] >= 0

    def go_on(self, row: int, steps: Steps, fits: bool) -> None:
        """Takes the next keyframe.

        Args:
          row: its row on the path.
          steps: what was measured between it and earlier ones.
          fits: whether a closure says what the path says.
        """
        mine = steps.used & (steps.i == row)
        last = mine & (steps.j == row - 1)
        self._counted = not (last & (steps.kind != "rotation")).any()
        if not last.any():
            self._rows = (self._rows[0] if self else row), row
        if self and (fits or (mine & (steps.j < self._rows[0])).any()):
            self.end()

    def end(self) -> None:
        """There is none any more."""
        self._rows = -1, -1

    def broken(self, row: int, ways_m: Float[np.ndarray, " n"], seconds: Float[np.ndarray, " n"]) -> int | None:
        """The row that the path begins anew with; None where it need not be given up.

        Args:
          row: of the last keyframe.
          ways_m: lengths of the last steps.
          seconds: that each took.
        """
        fastest = float((ways_m[:-1] / seconds[:-1]).max(initial=0.0))
        if self._counted and ways_m[-1] > self._extent_m + FASTER * fastest * seconds[-1]:
            return row
        return self._rows[1] if self and row - self._rows[0] + 1 >= PATIENCE else None
