"""The tree of frames that /tf and /tf_static describe, and transforms along it; never extrapolated.

Static transforms hold over the whole log, whatever their times.
"""

import itertools
from collections import defaultdict, deque
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from ebjax.io.logs.ros_poses import PoseSamples
from ebjax.io.poses import invert
from ebjax.io.timed_poses import MAX_GAP_S, poses_at
from ebjax.io.trajectory import Trajectory

BASES = ("base_footprint", "base_link")
Pair = tuple[str, str]


class TfTree:
    """Frames joined by transforms parent_from_child; one that moves beats a static one between the same frames.

    Args:
      static: the transforms of /tf_static, by parent and child.
      moving: those of /tf.
      by_receipt: whether the log's times are those of receipt.
      path: the log's, for messages.
    """

    def __init__(
        self,
        static: Mapping[Pair, PoseSamples],
        moving: Mapping[Pair, PoseSamples],
        *,
        by_receipt: bool = False,
        path: str = "",
    ):
        self.notes: tuple[str, ...] = ()
        self._edges: dict[Pair, Trajectory] = {}
        for pair, samples in static.items():
            poses = samples.matrices()
            poses = poses[np.isfinite(poses).all(axis=(1, 2))]
            if not len(poses) or pair[0] == pair[1]:
                continue
            if np.abs(poses - poses[-1:]).max() > 1e-3:
                self.notes += (f"/tf_static: {pair[1]} is given at several places in {pair[0]}; the last is used",)
            self._edges[pair] = Trajectory(np.zeros(1), poses[-1:], f"{path}: /tf_static", timed=False)
        for pair, samples in moving.items():
            trajectory, _ = samples.trajectory(f"{path}: /tf", by_receipt)
            if len(trajectory.timestamps) and pair[0] != pair[1]:
                self._edges[pair] = trajectory

    @property
    def frames(self) -> frozenset[str]:
        """All frames."""
        return frozenset(frame for pair in self._edges for frame in pair)

    def base(self, near: str) -> str | None:
        """base_footprint, else base_link, if joined with a frame; it may have a prefix, as robot1/base_link."""
        for name in BASES:
            for frame in sorted(self.frames | {near}):
                if frame.rsplit("/", 1)[-1] == name and self.chain(frame, near) is not None:
                    return frame
        return None

    def chain(self, to: str, start: str) -> list[Pair] | None:
        """The shortest way between two frames, as pairs of neighbours from `to` on; None without."""
        neighbours = defaultdict[str, list[str]](list)
        for parent, child in self._edges:
            neighbours[parent].append(child)
            neighbours[child].append(parent)
        before, queue = {start: start}, deque([start])
        while queue and to not in before:
            frame = queue.popleft()
            for other in neighbours[frame]:
                if other not in before:
                    before[other] = frame
                    queue.append(other)
        if to not in before:
            return None
        way = [to]
        while way[-1] != start:
            way.append(before[way[-1]])
        return list(itertools.pairwise(way))

    def _edge(self, pair: Pair) -> tuple[Trajectory, bool]:
        """The transform of two neighbours, and whether it is the inverse of the one that is asked for."""
        forward, backward = self._edges.get(pair), self._edges.get(pair[::-1])
        if forward is None or (backward is not None and backward.timed and not forward.timed):
            assert backward is not None
            return backward, True
        return forward, False

    def times(self, to: str, start: str) -> Float[np.ndarray, " N"]:
        """The times of the transform on the way that moves most often; none where nothing on it moves."""
        edges = [self._edge(pair)[0] for pair in self.chain(to, start) or []]
        return max((edge.timestamps for edge in edges if edge.timed), key=len, default=np.zeros(0))

    def at(self, to: str, start: str, times: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N 4 4"]:
        """to_from_start at some times, s; NaN without a way, and where one that moves has no samples around a time."""
        result = np.tile(np.eye(4), (len(times), 1, 1))
        way = self.chain(to, start)
        if way is None:
            return np.full_like(result, np.nan)
        for pair in way:
            edge, is_backward = self._edge(pair)
            if edge.timed:
                poses, _ = poses_at(edge, times, 0.0, MAX_GAP_S)
            else:
                poses = np.repeat(edge.poses, len(times), axis=0)
            result = result @ (invert(poses) if is_backward else poses)
        return result
