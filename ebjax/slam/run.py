"""What a whole run gave."""

import dataclasses
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from ebjax.features.verify import Verified
from ebjax.geometry.camera import Camera
from ebjax.odometry.motion import Motion
from ebjax.posegraph.graph import PoseGraph
from ebjax.posegraph.levenberg import Solution
from ebjax.slam.believe import KEPT
from ebjax.slam.lean import Lean
from ebjax.slam.look import Looked
from ebjax.slam.measured import Measured
from ebjax.slam.path import Path
from ebjax.slam.recall import Alike
from ebjax.views.run_view import RunView


@dataclasses.dataclass(frozen=True)
class Earlier:
    """What a run says of the map it was driven in.

    Attributes:
      count: keyframes of earlier runs; none where there is no map.
      poses: where they are by now.
      candidates: of all runs; i and j are rows of all keyframes.
      reasons: of each.
      in_map: whether closures join the run to the earlier ones.
    """

    count: int
    poses: Float[np.ndarray, "E 3"]
    candidates: Measured
    reasons: list[str]
    in_map: bool

    @property
    def closures(self) -> int:
        """How many kept ones tie the run to earlier runs."""
        kept = np.array([reason == KEPT for reason in self.reasons], bool)
        return int((kept & (self.candidates.i >= self.count) & (self.candidates.j < self.count)).sum())


@dataclasses.dataclass(frozen=True)
class Run:
    """A run, thought over. `candidates.i`, `.j` are frame numbers; `seen` and `floor` take rows of `keyframes`.

    Attributes:
      keyframes: frame numbers that were looked at.
      looked: their views and features, read when asked for.
      camera: with the mount that the run settled on.
      view: the floor view, under that camera.
      motion: how the robot moved between keyframes; None where wheels alone say it.
      firsts: of every keyframe the earlier one that looks most alike, a row; -1 where none was compared.
      candidates: verified candidates, measured.
      by_depth: whether depth measured them (else the metric floor).
      reasons: of each: "kept", or why not.
      path: what the closures corrected.
      graph: the path and the kept closures.
      solution: its optimum.
      poses: of all frames: x, y (m), heading (rad).
      seconds: of each stage.
      earlier: of the map it was driven in.
      lean: how the robot leans, where something says so.
      followed: without wheels, how many frames the floor showed to follow on the one before, and of how many.
      mirrored: where the floor was seen to mirror the room, a sentence about it and what was done.
    """

    keyframes: Int[np.ndarray, " N"]
    looked: Looked
    camera: Camera
    view: RunView
    motion: Motion | None
    firsts: Alike
    candidates: Measured
    by_depth: Bool[np.ndarray, " K"]
    reasons: list[str]
    path: Path
    graph: PoseGraph
    solution: Solution
    poses: Float[np.ndarray, "F 3"]
    seconds: dict[str, float]
    earlier: Earlier
    lean: Lean | None = None
    followed: tuple[int, int] | None = None
    mirrored: str | None = None

    def __repr__(self) -> str:
        kept = self.kept
        facing = int((kept & self.candidates.opposing).sum())
        return (
            f"Run({len(self.poses)} frames, {len(self.keyframes)} looked at, {kept.sum()} of {len(kept)} candidates "
            f"kept, {facing} from opposing views)"
        )

    @property
    def closures(self) -> Measured:
        """The candidates that became loop closures."""
        return self.candidates.rows(self.kept)

    @cached_property
    def kept(self) -> Bool[np.ndarray, " K"]:
        """Which candidates became loop closures."""
        return np.array([reason == KEPT for reason in self.reasons], bool)

    def seen(self, k: int) -> UInt8[np.ndarray, "h w 3"]:
        """The floor view of the k-th keyframe, of frame `keyframes[k]`."""
        return self.looked.seen(self.earlier.count + k)

    def floor(self, k: int) -> Bool[np.ndarray, "h w"]:
        """What of it is floor."""
        return self.looked.floor(self.earlier.count + k)

    def verified(self, k: int) -> Verified:
        """The matches of a candidate."""
        ends = np.searchsorted(self.keyframes, [self.candidates.i[k], self.candidates.j[k]])
        i, j = (self.earlier.count + ends).tolist()
        return self.looked.pair(i, j, bool(self.candidates.opposing[k])).verified

    def keypoints(self, frame: int) -> Float[np.ndarray, "K 2"]:
        """The keypoints of a keyframe by its frame number, px of the floor view."""
        row = self.earlier.count + int(np.searchsorted(self.keyframes, frame))
        return np.asarray(self.looked.landmarks(row).features.keypoints)
