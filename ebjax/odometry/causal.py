"""The robot's path as far as it has come: every keyframe hung on the one before by the wheels and the floor's step.

What is said of a step is said once, by what was known then; `odometry.motion` thinks it over when the run is whole.
"""

import numpy as np
from jaxtyping import Bool, Float

from ebjax.geometry.planar import adjoint, between, compose, inverse, inverse_covariance, log
from ebjax.odometry.chain import CARRIED_M, CARRIED_RAD, LIMIT
from ebjax.odometry.floor_steps import STILL_M
from ebjax.odometry.fuse import OWN_FLOOR
from ebjax.odometry.steps import Steps
from ebjax.odometry.wheels import WheelErrors

LOST = np.diag([CARRIED_M**2, CARRIED_M**2, CARRIED_RAD**2])
"""Covariance of a step that nothing measured."""


class Causal:
    """A growing path.

    Attributes:
      poses: x, y (m), heading (rad) of every keyframe.
      covariance: of every step, earlier_from_later, right tangent.
    """

    def __init__(self, errors: WheelErrors):
        self.errors = errors
        self._poses, self._steps = np.zeros((64, 3)), np.zeros((64, 3, 3))
        self._stamps, self._measured = np.zeros(64), np.zeros(64, bool)
        self._count = 0

    def __len__(self) -> int:
        """Returns the number of keyframes."""
        return self._count

    @property
    def poses(self) -> Float[np.ndarray, "N 3"]:
        """Of the keyframes."""
        return self._poses[: self._count]

    @property
    def covariance(self) -> Float[np.ndarray, "M 3 3"]:
        """Of the steps."""
        return self._steps[1 : self._count]

    @property
    def steps(self) -> Float[np.ndarray, "N 3 3"]:
        """Covariance of the step to every keyframe; of the first as wide as any."""
        return self._steps[: self._count]

    @property
    def measured(self) -> Bool[np.ndarray, " N"]:
        """Whether anything measured the step to every keyframe."""
        return self._measured[: self._count]

    def take_up(
        self, stamp_s: float, pose: Float[np.ndarray, "3"], step: Float[np.ndarray, "3 3"], measured: bool
    ) -> None:
        """Adds a keyframe as it was."""
        self._append(stamp_s, pose, step, measured)

    def begin(self, stamp_s: float, pose: Float[np.ndarray, "3"]) -> None:
        """Adds a keyframe that follows on no other: nothing is known of a step to it."""
        self._append(stamp_s, pose, LOST, False)

    def go_on(self, stamp_s: float, steps: Steps, wheels: Float[np.ndarray, "2 3"] | None) -> bool:
        """Adds a keyframe.

        Args:
          stamp_s: its time, s.
          steps: what was measured between it and earlier ones.
          wheels: odometry of the keyframe before and of this one; None without.

        Returns:
          Whether odometry jumped: the floor contradicts it.
        """
        row, parts, jumped = self._count, [], False
        counted, noise = None, None
        if wheels is not None:
            counted = between(wheels[0], wheels[1])
            sigma = self.errors.step_sigmas(wheels)[0]
            length, turn = np.hypot(*counted[:2]), abs(counted[2])
            wrong = np.array([self.errors.scale_sigma * length, 0.0, self.errors.gain_sigma * turn])
            noise = np.diag(sigma**2)
        near = np.flatnonzero(steps.used & (steps.j == row - 1) & (steps.i == row) & (steps.kind != "rotation"))
        if len(near):
            step = inverse(steps.i_from_j[near[0]])
            wide = inverse_covariance(steps.i_from_j[near[0]], steps.covariance[near[0]])
            # The views of a keyframe that is measured against several others are not counted as often.
            wide = wide * max(1.0, int((steps.used & (steps.i == row)).sum())) ** OWN_FLOOR
            parts.append((step, wide))
            if counted is not None and noise is not None:
                off = log(compose(inverse(step), counted))
                apart = float(off @ np.linalg.solve(wide + noise + np.diag(wrong**2), off))
                if apart > LIMIT:
                    still = np.hypot(*step[:2]) < STILL_M and np.hypot(*counted[:2]) > 3 * STILL_M
                    # Matches that stand still while the wheels turn lie on the robot itself.
                    parts, jumped = ([], False) if still else (parts, True)
        if counted is not None and noise is not None and not jumped:
            parts.append((counted, noise + np.diag(wrong**2)))
        if not parts:
            seconds = stamp_s - self._stamps[row - 1]
            parts.append((self._carried(seconds), LOST))
            fused, covariance, known = *parts[0], False
        else:
            fused, covariance = together(parts)
            known = True
        self._append(stamp_s, compose(self._poses[row - 1], fused), covariance, known)
        return jumped

    def expected(self, stamp_s: float) -> Float[np.ndarray, "3"]:
        """The step to a keyframe at that time if the robot goes on as it did, earlier_from_later."""
        return self._carried(stamp_s - self._stamps[self._count - 1])

    def spread_since(self, row: int) -> Float[np.ndarray, "3 3"]:
        """Covariance of the last pose seen from that of a row, in its right tangent."""
        poses, steps = self._poses[row : self._count], self._steps[row + 1 : self._count]
        ad = adjoint(between(np.broadcast_to(poses[-1], poses[1:].shape), poses[1:]))
        return np.sum(ad @ steps @ np.swapaxes(ad, 1, 2), 0)

    def _carried(self, seconds: float) -> Float[np.ndarray, "3"]:
        row = self._count
        if row < 2 or not self._measured[row - 1]:
            return np.zeros(3)
        before = max(self._stamps[row - 1] - self._stamps[row - 2], 1e-6)
        return between(self._poses[row - 2], self._poses[row - 1]) * min(seconds / before, 10.0)

    def _append(self, stamp_s, pose, covariance, known) -> None:
        if self._count == len(self._poses):
            for name in ("_poses", "_steps", "_stamps", "_measured"):
                old = getattr(self, name)
                setattr(self, name, np.concatenate([old, np.zeros_like(old)]))
        row, self._count = self._count, self._count + 1
        self._poses[row], self._steps[row], self._stamps[row], self._measured[row] = pose, covariance, stamp_s, known


def together(
    parts: list[tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]],
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Several measurements of one relative pose as one, with its covariance in the right tangent."""
    first, information, pull = parts[0][0], np.zeros((3, 3)), np.zeros(3)
    for pose, covariance in parts:
        off = log(compose(inverse(first), pose))
        weight = np.linalg.inv(covariance)
        information, pull = information + weight, pull + weight @ off
    covariance = np.linalg.inv(information)
    return compose(first, covariance @ pull), covariance
