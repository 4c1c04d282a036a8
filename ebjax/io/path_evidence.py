"""What a path of poses says of its frames: whether the body stands upright, moves level, and where it heads.

A step is the straight line between two poses some way apart, so that neither noise nor a jump counts for much.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

TILT_DEG = 25.0
UPRIGHT_SHARE = 0.9
LEVEL_SHARE = 0.8
SHORT_M = 1.0
FEW_STEPS = 5
MAX_POSES = 4000


@dataclass(frozen=True)
class Evidence:
    """How poses look when they are read as world_from_base, z up in both.

    Attributes:
      upright: the share of poses with z within 25 degrees of up.
      tilt_deg: the mean angle of z from up.
      level: the share of steps that climb or fall by less than 25 degrees; 1 for a path too short to judge.
      slope_deg: the mean angle of the steps from level; 0 for a path too short.
      lean_deg: the angle of the body's mean up from z.
      lift_deg: the mean angle of the steps from the body's own x-y plane; 0 for a path too short.
      astray_deg: the mean angle of the steps from the body's x axis, forwards or backwards; 0 for a path too short.
      backwards: the share of steps that go backwards; 0 for a path too short.
    """

    upright: float
    tilt_deg: float
    level: float
    slope_deg: float
    lean_deg: float
    lift_deg: float
    astray_deg: float
    backwards: float

    @property
    def fits(self) -> bool:
        """Whether a robot on floors can have moved like this."""
        return self.upright >= UPRIGHT_SHARE and self.level >= LEVEL_SHARE

    @property
    def cost_deg(self) -> float:
        """How far from the ideal robot, to choose between readings that fit; driving sideways or backwards is rare."""
        return self.tilt_deg + self.slope_deg + self.astray_deg / 4 + 10 * self.backwards


def thinned(poses: Float[np.ndarray, "N 4 4"]) -> Float[np.ndarray, "M 4 4"]:
    """Returns every k-th pose, at most 4000."""
    return poses[:: -(-len(poses) // MAX_POSES)]


def extent_m(positions: Float[np.ndarray, "N 3"]) -> float:
    """The diagonal of the box around the positions, its rarest 2% left out, m."""
    return float(np.linalg.norm(np.quantile(positions, 0.99, axis=0) - np.quantile(positions, 0.01, axis=0)))


def steps(positions: Float[np.ndarray, "N 3"], length_m: float) -> tuple[Int[np.ndarray, " S"], Int[np.ndarray, " S"]]:
    """Cuts a path into steps of at least `length_m`; returns where each starts and ends."""
    chosen = [0]
    for k in range(1, len(positions)):
        d = positions[k] - positions[chosen[-1]]
        if d @ d >= length_m**2:
            chosen.append(k)
    return np.array(chosen[:-1], dtype=np.int64), np.array(chosen[1:], dtype=np.int64)


def measure(
    rotation: Float[np.ndarray, "N 3 3"],
    positions: Float[np.ndarray, "N 3"],
    cut: tuple[Int[np.ndarray, " S"], Int[np.ndarray, " S"]],
) -> Evidence:
    """Measures poses as world_from_base.

    Args:
      rotation: of the body.
      positions: m.
      cut: the path's steps; none for a path too short to judge.
    """
    tilt = np.degrees(np.arccos(np.clip(rotation[:, 2, 2], -1, 1)))
    up = rotation[:, 2].mean(axis=0)
    lean = float(np.degrees(np.arctan2(np.linalg.norm(up[:2]), up[2])))
    start, end = cut
    if not len(start):
        return Evidence(float((tilt < TILT_DEG).mean()), float(tilt.mean()), 1.0, 0.0, lean, 0.0, 0.0, 0.0)
    ahead = positions[end] - positions[start]
    ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    slope = np.degrees(np.arcsin(np.clip(np.abs(ahead[:, 2]), 0, 1)))
    # The body's axes half-way: the mean of both ends, which need not be a rotation for an angle's sake.
    middle = (rotation[start] + rotation[end]) / 2
    seen = np.einsum("sji,sj->si", middle, ahead)
    length = np.maximum(np.linalg.norm(seen, axis=1), 1e-9)
    return Evidence(
        upright=float((tilt < TILT_DEG).mean()),
        tilt_deg=float(tilt.mean()),
        level=float((slope < TILT_DEG).mean()),
        slope_deg=float(slope.mean()),
        lean_deg=lean,
        lift_deg=float(np.degrees(np.arcsin(np.clip(np.abs(seen[:, 2]) / length, 0, 1))).mean()),
        astray_deg=float(np.degrees(np.arctan2(np.abs(seen[:, 1]), np.abs(seen[:, 0]))).mean()),
        backwards=float((seen[:, 0] < 0).mean()),
    )


def level_steps(positions: Float[np.ndarray, "N 3"]) -> tuple[Int[np.ndarray, " S"], Int[np.ndarray, " S"]]:
    """Steps of 0.2 to 1 m to measure with; none where the path is too short to judge."""
    extent = extent_m(positions)
    start, end = steps(positions, float(np.clip(extent / 20, 0.2, 1.0)))
    return (start, end) if extent >= SHORT_M and len(start) >= FEW_STEPS else (start[:0], end[:0])


def sweeps(poses: Float[np.ndarray, "N 4 4"], inverse: Float[np.ndarray, "N 4 4"]) -> bool:
    """Whether a path is longer than its inverse's, as an inverted path is: each turn sweeps it round the origin."""
    read, driven = (np.linalg.norm(np.diff(p[:, :3, 3], axis=0), axis=1).sum() for p in (poses, inverse))
    return bool(driven < 0.6 * read)
