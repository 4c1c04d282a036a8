"""Where keyframes are kept: in memory here, in a map's file by `ebjax.mapping.store`."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from ebjax.slam.packed import Arrays


class Between(NamedTuple):
    """A frame that is no keyframe: its number, time (s), name, and where it is from the keyframe before it."""

    frame: int
    stamp_s: float
    name: str
    keyframe_from_base: Float[np.ndarray, "3"]


@runtime_checkable
class Shelf(Protocol):
    """What packed keyframes are read from, by row."""

    def arrays(self, row: int) -> Arrays:
        """Those of a keyframe."""
        ...


@runtime_checkable
class Store(Shelf, Protocol):
    """Packed keyframes with all that was measured when they came, by row.

    What `keep` was given is there for good when it returns, or it raises OSError.

    Attributes:
      current: the piece of unbroken path, a session, that is added to.
    """

    current: int

    def piece(self, row: int) -> int:
        """The piece of path that a keyframe belongs to."""
        ...

    def settled_step(self, row: int, kept: Arrays) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """Of a keyframe of an earlier piece: its pose on the path, and the covariance of the step to it.

        As its run was thought over at its end, else as they came: `kept["at.pose"]` and `kept["at.step"]`.
        """
        ...

    def __len__(self) -> int:
        """Returns the number of keyframes."""
        ...

    def keep(self, kept: Arrays, name: str, between: Sequence[Between]) -> None:
        """Adds a keyframe, and the frames since the one before, which these place."""
        ...


class InMemory:
    """All in memory."""

    current = 0

    def __init__(self):
        self._kept: list[Arrays] = []

    def piece(self, row: int) -> int:
        """All are of one."""
        return 0

    def settled_step(self, row: int, kept: Arrays) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """As it came."""
        return kept["at.pose"], kept["at.step"]

    def __len__(self) -> int:
        """Returns the number of keyframes."""
        return len(self._kept)

    def arrays(self, row: int) -> Arrays:
        """Those of a keyframe."""
        return self._kept[row]

    def keep(self, kept: Arrays, name: str = "", between: Sequence[Between] = ()) -> None:
        """Adds a keyframe."""
        self._kept.append(kept)


class WithNewest:
    """A store and the keyframe that is in work."""

    def __init__(self, store: Store):
        self.store, self.current = store, store.current
        self.newest: Arrays = {}

    def piece(self, row: int) -> int:
        """The piece of path that a keyframe belongs to."""
        return self.current if row == len(self.store) else self.store.piece(row)

    def settled_step(self, row: int, kept: Arrays) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """Of a keyframe of an earlier piece."""
        return self.store.settled_step(row, kept)

    def __len__(self) -> int:
        """Returns the number of keyframes that are kept."""
        return len(self.store)

    def arrays(self, row: int) -> Arrays:
        """Those of a keyframe."""
        return self.newest if row == len(self.store) else self.store.arrays(row)

    def keep(self, kept: Arrays, name: str = "", between: Sequence[Between] = ()) -> None:
        """Adds the one in work."""
        self.store.keep(kept, name, between)
