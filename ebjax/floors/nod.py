"""A body that nods while the robot drives: pitch and roll about the base's origin on the floor.

Pitch and roll are each n (0.8 sin(2 pi 0.37 t + a) + 0.6 sin(2 pi 0.73 t + b)), n = `robot.nod_deg`, with phases of
their own: their rms over time is n / sqrt(2), and they never exceed 1.4 n. Pitch is nose down, roll right side down.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

FREQUENCIES_HZ = np.array([0.37, 0.73])
SHARES = np.array([0.8, 0.6])
STREAM = 0x6E6F64
"""Nodding draws from a stream of its own: with it, a seed's way, odometry and light are those without."""


class Nod(NamedTuple):
    """How a body nods."""

    nod_rad: float
    phases: Float[np.ndarray, "2 2"]
    """Of pitch's two sines, and of roll's."""

    def angles(self, times_s: Float[np.ndarray, "*s"]) -> Float[np.ndarray, "*s 2"]:
        """Pitch and roll, rad."""
        waves = np.sin(2 * np.pi * FREQUENCIES_HZ * times_s[..., None, None] + self.phases)
        return self.nod_rad * (SHARES * waves).sum(axis=-1)


def make_nod(nod_deg: float, seed: int) -> Nod | None:
    """The nodding of a seed; None for 0 degrees."""
    if not nod_deg:
        return None
    phases = np.random.default_rng((abs(seed), seed < 0, STREAM)).uniform(0, 2 * np.pi, (2, 2))
    return Nod(float(np.radians(nod_deg)), phases)


def nodded(
    world_from_base: Float[np.ndarray, "*s 4 4"], nod: Nod | None, times_s: Float[np.ndarray, "*s"]
) -> Float[np.ndarray, "*s 4 4"]:
    """The body's pose on a base: world_from_base R_y(pitch) R_x(roll)."""
    if nod is None:
        return world_from_base
    return world_from_base @ _tilt(nod.angles(times_s))


def with_tilt_of(odom_from_base: Float[np.ndarray, "N 4 4"], body: Float[np.ndarray, "N 4 4"]) -> np.ndarray:
    """Level poses with the true pitch and roll of a body, as an odometry has them that an IMU aids."""
    yaw = np.arctan2(body[:, 1, 0], body[:, 0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    tilted = odom_from_base.copy()
    level_from_world = np.zeros((len(yaw), 3, 3))
    level_from_world[:, 0, 0], level_from_world[:, 0, 1] = c, s
    level_from_world[:, 1, 0], level_from_world[:, 1, 1] = -s, c
    level_from_world[:, 2, 2] = 1
    tilted[:, :3, :3] = odom_from_base[:, :3, :3] @ level_from_world @ body[:, :3, :3]
    return tilted


def _tilt(angles: Float[np.ndarray, "*s 2"]) -> Float[np.ndarray, "*s 4 4"]:
    """R_y(pitch) R_x(roll)."""
    (sp, cp), (sr, cr) = ((np.sin(angles[..., k]), np.cos(angles[..., k])) for k in (0, 1))
    matrices = np.zeros((*angles.shape[:-1], 4, 4))
    matrices[..., 0, 0], matrices[..., 0, 1], matrices[..., 0, 2] = cp, sp * sr, sp * cr
    matrices[..., 1, 1], matrices[..., 1, 2] = cr, -sr
    matrices[..., 2, 0], matrices[..., 2, 1], matrices[..., 2, 2] = -sp, cp * sr, cp * cr
    matrices[..., 3, 3] = 1
    return matrices
