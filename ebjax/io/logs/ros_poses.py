"""Poses of a topic or of two frames while they are collected, then as a trajectory on one clock."""

from array import array
from collections.abc import Iterable

import numpy as np
from jaxtyping import Float, Int64

from ebjax.io.poses import poses_from, rotation_from_quaternion
from ebjax.io.trajectory import Trajectory

MOST_M = 1e9
"""No robot is farther from an origin on the earth; such a number is damaged, and its square may be infinite."""


class PoseSamples:
    """Poses with the times that they are stamped with and were received at, ns."""

    def __init__(self) -> None:
        self._times, self._values = array("q"), array("d")

    def add(
        self, stamp_ns: int, received_ns: int, translation: Iterable[float], quaternion: Iterable[float]
    ) -> "PoseSamples":
        """Adds one; the quaternion is wxyz."""
        self._times.extend((stamp_ns, received_ns))
        self._values.extend(translation)
        self._values.extend(quaternion)
        return self

    def __len__(self) -> int:
        """Returns how many there are."""
        return len(self._times) // 2

    def times_ns(self) -> Int64[np.ndarray, "N 2"]:
        """Stamp and receipt of each."""
        return np.array(self._times, np.int64).reshape(-1, 2)

    def matrices(self) -> Float[np.ndarray, "N 4 4"]:
        """The poses; NaN where a quaternion is no rotation, or a number is not finite or farther than MOST_M."""
        values = np.array(self._values, np.float64).reshape(-1, 7)
        valid = np.all(np.abs(values) < MOST_M, axis=1)
        values = np.where(valid[:, None], values, [[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
        valid &= np.abs(np.linalg.norm(values[:, 3:], axis=1) - 1) < 0.05
        quaternions = np.where(valid[:, None], values[:, 3:], [[1.0, 0.0, 0.0, 0.0]])
        poses = poses_from(rotation_from_quaternion(quaternions), values[:, :3])
        return np.where(valid[:, None, None], poses, np.nan)

    def trajectory(self, name: str, by_receipt: bool) -> tuple[Trajectory, tuple[str, ...]]:
        """The poses in time order, and what was left out: invalid ones, stamps of 0, a time's second pose.

        Args:
          name: of the topic and its file, for messages.
          by_receipt: whether the times are those of receipt.
        """
        poses, times = self.matrices(), self.times_ns()[:, int(by_receipt)]
        valid = np.isfinite(poses).all(axis=(1, 2)) & (times > 0)
        _, first = np.unique(times[valid], return_index=True)
        kept = np.flatnonzero(valid)[first]
        notes = []
        if not valid.all():
            notes.append(
                f"{name}: {(~valid).sum()} of {len(self)} poses are left out: no rotation, not finite, or stamp 0"
            )
        if len(kept) < valid.sum():
            notes.append(f"{name}: {valid.sum() - len(kept)} poses at times that occur twice are left out")
        return Trajectory(times[kept] * 1e-9, poses[kept], name), tuple(notes)
