"""The path that candidates are compared with, and how it may err; what is summed up along it is gone on with."""

import dataclasses
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from ebjax.geometry.planar import adjoint


@dataclasses.dataclass(frozen=True)
class Walked:
    """A path of steps.

    Attributes:
      poses: x, y (m), heading (rad) of the keyframes.
      steps: covariance of each of the N - 1 steps, right tangent.
      piece: which unbroken piece of path a keyframe belongs to; nothing is known between two pieces.
      given_m: the way to every keyframe, m; None: the sum of the steps.
    """

    poses: Float[np.ndarray, "N 3"]
    steps: Float[np.ndarray, "M 3 3"]
    piece: Int[np.ndarray, " N"]
    given_m: Float[np.ndarray, " N"] | None = None

    @cached_property
    def travelled(self) -> Float[np.ndarray, " N"]:
        """The way to every keyframe, m."""
        return np.cumsum(np.append(0.0, self._ways(0))) if self.given_m is None else self.given_m

    @cached_property
    def spread(self) -> Float[np.ndarray, "N 3 3"]:
        """C_n = sum Ad Q Ad^T: the odometry from m to n has covariance C_n - C_m, in the world."""
        return np.cumsum(np.concatenate([np.zeros((1, 3, 3)), self._terms(0)]), 0)

    def gone_on(
        self, poses: Float[np.ndarray, "n 3"], steps: Float[np.ndarray, "m 3 3"], piece: Int[np.ndarray, " n"]
    ) -> "Walked":
        """A longer path that begins as this one; the same, bit for bit, as one made anew."""
        longer, done = Walked(poses, steps, piece), len(self.poses) - 1
        if done > 0:
            # A sum that begins at the last one adds in the same order.
            sums = {"travelled": (self.travelled, longer._ways), "spread": (self.spread, longer._terms)}
            for name, (before, further) in sums.items():
                more = np.cumsum(np.concatenate([before[-1:], further(done)]), 0)
                longer.__dict__[name] = np.concatenate([before, more[1:]])
        return longer

    def _ways(self, since: int) -> Float[np.ndarray, " n"]:
        ways = np.linalg.norm(np.diff(self.poses[since:, :2], axis=0), axis=1)
        return np.where(np.diff(self.piece[since:]) == 0, ways, 0.0)

    def _terms(self, since: int) -> Float[np.ndarray, "n 3 3"]:
        ad = adjoint(self.poses[since + 1 :])
        return ad @ self.steps[since:] @ np.swapaxes(ad, 1, 2)
