"""The path that closures correct: nodes of the pose graph, what ties successive ones, and the frames between them."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int

from ebjax.geometry.planar import between, compose, inverse, log
from ebjax.odometry.chain import Edges
from ebjax.odometry.motion import Motion
from ebjax.odometry.wheels import WheelErrors
from ebjax.posegraph.graph import PoseGraph, make_graph
from ebjax.slam.measured import Measured

SYSTEMATIC = 4.0
"""What steps share (a keypoint's bias, the rest of the tilt) adds up straight, not as a random walk: what a closure may
contradict is so many times the variance that independent steps would have."""


@dataclasses.dataclass(frozen=True)
class Path:
    """N nodes of a run of F frames.

    Attributes:
      frames: frame number of every node.
      poses: x, y (m), heading (rad), before any closure.
      covariance: of each of the N - 1 steps, right tangent, as closures are compared with it.
      edges: the chain, one edge a step in order, then any others.
      row: of every frame, the node it hangs on.
      row_from_frame: its pose there.
      share: how far a frame is on the way to the next node, by which it takes part in what the next one moves.
    """

    frames: Int[np.ndarray, " N"]
    poses: Float[np.ndarray, "N 3"]
    covariance: Float[np.ndarray, "M 3 3"]
    edges: Edges
    row: Int[np.ndarray, " F"]
    row_from_frame: Float[np.ndarray, "F 3"]
    share: Float[np.ndarray, " F"]

    def graph(self, candidates: Measured, kept: Bool[np.ndarray, " K"]) -> PoseGraph:
        """The path and the kept closures, whose i and j are frames; the robust kernel applies to closures only."""
        i, j = (np.searchsorted(self.frames, frames[kept]) for frames in (candidates.i, candidates.j))
        edges = self.edges
        closures = np.linalg.inv(candidates.covariance[kept])
        return make_graph(
            self.poses.astype(np.float64),
            np.concatenate([edges.i, i]),
            np.concatenate([edges.j, j]),
            np.concatenate([edges.measured, candidates.i_from_j[kept]]).astype(np.float64),
            np.concatenate([edges.information, closures]).astype(np.float64),
            robust=np.concatenate([np.zeros(len(edges.i), bool), np.ones(int(kept.sum()), bool)]),
        )

    def everywhere(self, poses: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "F 3"]:
        """The poses of all frames where the nodes are at `poses`."""
        if len(self.frames) == len(self.row):
            return poses
        step = between(self.poses[:-1], self.poses[1:])
        pull = np.zeros((len(poses), 3))
        pull[:-1] = log(compose(inverse(step), between(poses[:-1], poses[1:])))
        moved = compose(poses[self.row], self.row_from_frame)
        return compose(moved, self.share[:, None] * pull[self.row])


def path_of_wheels(odom_from_base: Float[np.ndarray, "F 3"], errors: WheelErrors) -> Path:
    """Every frame is a node, and the wheels tie it to the one before."""
    count = len(odom_from_base)
    rows, step = np.arange(count - 1), np.diff(odom_from_base, axis=0)
    c, s = np.cos(odom_from_base[:-1, 2]), np.sin(odom_from_base[:-1, 2])
    local = np.stack([c * step[:, 0] + s * step[:, 1], c * step[:, 1] - s * step[:, 0], step[:, 2]], 1)
    weights = np.einsum("na,ab->nab", errors.step_sigmas(odom_from_base) ** -2.0, np.eye(3))
    edges = Edges(rows, rows + 1, local, weights, np.zeros(count - 1, bool))
    every = np.arange(count)
    none = np.zeros((count, 3)), np.zeros(count)
    return Path(every, odom_from_base, errors.step_covariance(odom_from_base), edges, every, *none)


def path_of_motion(motion: Motion, way: Float[np.ndarray, "F 3"]) -> Path:
    """Keyframes are nodes; the frames between hang on the one before, on the way that `way` has between them.

    Args:
      motion: over the keyframes.
      way: wheels or measured steps at all frames; only what lies between two keyframes counts.
    """
    frames = motion.frames
    count = len(way)
    every = np.arange(count)
    row = np.clip(np.searchsorted(frames, every, side="right") - 1, 0, len(frames) - 1)
    after = frames[np.minimum(row + 1, len(frames) - 1)]
    relative = between(way[frames[row]], way)
    # A frame takes its part of what separates the way from the settled path between the keyframes around it.
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0) * [1, 1, 0.3], axis=1))])
    whole = length[after] - length[frames[row]]
    inside = (every > frames[row]) & (after > frames[row])
    share = np.where(inside & (whole > 0), (length - length[frames[row]]) / np.where(whole > 0, whole, 1), 0.0)
    settled = np.zeros((len(frames), 3))
    there = between(way[frames[:-1]], way[frames[1:]])
    settled[:-1] = log(compose(inverse(there), between(motion.poses[:-1], motion.poses[1:])))
    relative = compose(relative, share[:, None] * settled[row])
    edges = Edges(*(np.concatenate([a, b]) for a, b in zip(motion.chain, motion.further, strict=True)))
    poses = compose(np.broadcast_to(way[frames[0]], motion.poses.shape), motion.poses)  # starts where the odometry does
    return Path(frames, poses, SYSTEMATIC * motion.covariance, edges, row, relative, share)
