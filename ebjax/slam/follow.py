"""A run without wheels: the floor follows the robot from frame to frame and says which frames are keyframes."""

from bisect import bisect_left

import numpy as np
from jaxtyping import Float

from ebjax.geometry.planar import compose, inverse
from ebjax.odometry.floor_steps import table_of
from ebjax.slam.look import Looked
from ebjax.slam.packed import Arrays


class LastFrames:
    """The packed frames that the next is still measured against, by frame number."""

    def __init__(self):
        self.kept: dict[int, Arrays] = {}

    def arrays(self, row: int) -> Arrays:
        """Those of a frame."""
        return self.kept[row]


class Follower:
    """Measures every frame against the one before; a step that fails goes on at the last speed.

    A frame is a keyframe where the robot has moved or turned enough since the last one, and at either side of a step
    that failed.

    Attributes:
      frames: numbers of the frames that were read.
      poses: where each is thought to be: x, y (m), heading (rad).
      good: whether the floor showed each but the first to follow on the one before.
    """

    def __init__(self, looked: Looked, last: LastFrames, keyframe_m: float, keyframe_deg: float, tolerance_m: float):
        self.frames: list[int] = []
        self.poses: list[Float[np.ndarray, 3]] = []
        self.good: list[bool] = []
        self._looked, self._last = looked, last
        self._limits, self._tolerance_m = (keyframe_m, np.radians(keyframe_deg)), tolerance_m
        self._stamp_s, self._speed = 0.0, np.zeros(3)
        self._keyframe, self._told = 0, 0

    def add(self, number: int, stamp_s: float, kept: Arrays) -> list[int]:
        """Takes a frame; returns the numbers of those that are keyframes now: itself, or the one before, too."""
        self._last.kept[number] = kept
        if not self.frames:
            self.frames, self.poses, self._stamp_s = [number], [np.zeros(3)], stamp_s
            return [number]
        before = self.frames[-1]
        table = table_of(
            self._looked.pairs(np.array([number]), np.array([before])), self._looked.camera, self._tolerance_m
        )
        seconds, good = stamp_s - self._stamp_s, bool(table.used[0])
        step = inverse(table.i_from_j[0]) if good else self._speed * seconds
        self._speed = step / seconds if good else self._speed
        self.frames.append(number)
        self.poses.append(compose(self.poses[-1], step))
        self.good.append(good)
        self._stamp_s = stamp_s
        moved = self.poses[-1] - self.poses[self._keyframe]
        due = []
        if not good and self._keyframe < len(self.frames) - 2:
            # Both ends of a failed step, so that something else may measure it.
            due.append(before)
        if not good or np.hypot(moved[0], moved[1]) >= self._limits[0] or abs(moved[2]) >= self._limits[1]:
            due.append(number)
            self._keyframe = len(self.frames) - 1
        for old in [n for n in self._last.kept if n < before]:
            del self._last.kept[old]
        return due

    def told_up_to(self, number: int) -> dict[str, np.ndarray]:
        """The frames since the keyframe before up to that one, as arrays."""
        end = bisect_left(self.frames, number) + 1
        start, self._told = self._told, end
        return {
            "follow.frames": np.array(self.frames[start:end], np.int64),
            "follow.poses": np.array(self.poses[start:end]).reshape(-1, 3),
            "follow.good": np.array(self.good[max(start - 1, 0) : end - 1], bool),
            "follow.speed": self._speed.copy(),
        }

    def take_up(self, number: int, stamp_s: float, kept: Arrays) -> None:
        """Goes on from a keyframe that was kept."""
        self.frames += kept["follow.frames"].tolist()
        self.poses += list(kept["follow.poses"])
        self.good += kept["follow.good"].tolist()
        self._told = len(self.frames)
        self._keyframe, self._stamp_s, self._speed = len(self.frames) - 1, stamp_s, kept["follow.speed"]
        self._last.kept = {number: kept}

    def pose_of(self, number: int) -> Float[np.ndarray, "3"]:
        """Where one of the frames is thought to be."""
        return self.poses[bisect_left(self.frames, number)]

    def kept(self, number: int) -> Arrays:
        """The packed frame of one that is due."""
        return self._last.kept[number]

    def everywhere(self, count: int) -> Float[np.ndarray, "F 3"]:
        """Where every frame of the run is thought to be."""
        path, every = np.array(self.poses), np.arange(count)
        return np.stack([np.interp(every, self.frames, path[:, axis]) for axis in range(3)], 1)
