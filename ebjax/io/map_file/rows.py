"""The rows of a map, one by one as they are written, and in columns as they are read."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

Arrays = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class SessionRow:
    """One stretch of continuous driving.

    Attributes:
      id: from 1 on, never given twice.
      name: of the log or the robot.
      started: when, ISO 8601.
      finished: whether `end_session` was called.
      facts: what JSON holds: camera, settings.
      state: names of its arrays; `MapFile.state` reads them.
    """

    id: int
    name: str
    started: str
    finished: bool
    facts: dict[str, Any]
    state: tuple[str, ...] = ()


@dataclass(frozen=True)
class KeyframeRow:
    """A keyframe. `pose`: map_from_base as x, y, heading."""

    id: int
    session: int
    frame: int
    stamp_s: float
    name: str
    pose: Float[np.ndarray, " 3"]


@dataclass(frozen=True)
class FrameRow:
    """A frame that is no keyframe, placed by one."""

    frame: int
    stamp_s: float
    name: str
    keyframe: int
    keyframe_from_base: Float[np.ndarray, " 3"]


@dataclass(frozen=True)
class EdgeRow:
    """A measurement between two keyframes, kept or not. `kind`: "step", "closure" and what else the engine has."""

    id: int
    kind: str
    i: int
    j: int
    opposing: bool
    kept: bool
    reason: str
    i_from_j: Float[np.ndarray, " 3"]
    covariance: Float[np.ndarray, "3 3"]
    inliers: int = 0
    matches: int = 0
    distance: float = field(default=float("nan"))


@dataclass(frozen=True)
class Keyframes:
    """Keyframes in the order of their ids; `pose` as last settled."""

    id: Int[np.ndarray, " n"]
    session: Int[np.ndarray, " n"]
    frame: Int[np.ndarray, " n"]
    stamp_s: Float[np.ndarray, " n"]
    name: tuple[str, ...]
    pose: Float[np.ndarray, "n 3"]

    def __len__(self) -> int:
        return len(self.id)


@dataclass(frozen=True)
class Frames:
    """Frames that are no keyframes, in the order in which they came."""

    frame: Int[np.ndarray, " n"]
    stamp_s: Float[np.ndarray, " n"]
    name: tuple[str, ...]
    keyframe: Int[np.ndarray, " n"]
    keyframe_from_base: Float[np.ndarray, "n 3"]

    def __len__(self) -> int:
        return len(self.frame)


@dataclass(frozen=True)
class Edges:
    """Edges in the order of their ids."""

    id: Int[np.ndarray, " n"]
    kind: tuple[str, ...]
    i: Int[np.ndarray, " n"]
    j: Int[np.ndarray, " n"]
    opposing: Bool[np.ndarray, " n"]
    kept: Bool[np.ndarray, " n"]
    reason: tuple[str, ...]
    i_from_j: Float[np.ndarray, "n 3"]
    covariance: Float[np.ndarray, "n 3 3"]
    inliers: Int[np.ndarray, " n"]
    matches: Int[np.ndarray, " n"]
    distance: Float[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.id)

    def row(self, k: int) -> EdgeRow:
        """One of them."""
        values = (getattr(self, field.name)[k] for field in fields(self))
        return EdgeRow(*(value.item() if isinstance(value, np.generic) else value for value in values))
