"""How wheel odometry errs: noise of every step, and what is wrong with all of them, told by the floor's steps."""

import dataclasses

import numpy as np
from jaxtyping import Float

from ebjax.geometry.planar import between


@dataclasses.dataclass(frozen=True)
class WheelErrors:
    """How wheel odometry errs: what one step's standard deviation is made of, and what may be wrong with all steps."""

    translation: float = 0.03
    """Per metre travelled, along and across."""
    heading_deg_per_sqrt_m: float = 2.0
    """Random walk of the heading, degrees per square root of a metre."""
    turning: float = 0.03
    """Of the heading, per radian turned."""
    scale_sigma: float = 0.03
    """Standard deviation of the wheels' scale: metres counted per metre driven."""
    gain_sigma: float = 0.1
    """... of the heading's gain: radians counted per radian turned."""
    rest_deg_per_s: float = 0.1
    """... of the heading's drift at rest, degrees per second."""

    def step_sigmas(self, odom_from_base: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "M 3"]:
        """Standard deviation (x m, y m, heading rad) of each of the N - 1 steps, in the step's own frame."""
        step = np.diff(odom_from_base, axis=0)
        distance = np.linalg.norm(step[:, :2], axis=1)
        turned = np.abs(np.arctan2(np.sin(step[:, 2]), np.cos(step[:, 2])))
        along = self.translation * distance + 1e-3
        heading = np.hypot(
            np.radians(self.heading_deg_per_sqrt_m) * np.sqrt(distance), self.turning * turned
        ) + np.radians(0.02)
        return np.stack([along, along, heading], 1)

    def step_covariance(self, odom_from_base: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "M 3 3"]:
        """Covariance of each step, without what is wrong with all of them."""
        return np.einsum("na,ab->nab", self.step_sigmas(odom_from_base) ** 2, np.eye(3))


@dataclasses.dataclass(frozen=True)
class Systematic:
    """What is wrong with all of a run's wheel steps, and how well that is known (standard deviations).

    Attributes:
      scale: metres driven per metre counted.
      gain: radians turned per radian counted.
      bend_deg_per_m: turned per metre driven, though none was counted.
      rest_deg_per_s: turned per second at rest, though the opposite was counted.
      sigma: of the four, in this order.
      steps: how many steps told it.
    """

    scale: float = 1.0
    gain: float = 1.0
    bend_deg_per_m: float = 0.0
    rest_deg_per_s: float = 0.0
    sigma: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    steps: int = 0


AT_REST_M, AT_REST_RAD = 0.01, 0.02
BEND_SIGMA_DEG = 2.0


def systematic(
    counted: Float[np.ndarray, "K 3"],
    measured: Float[np.ndarray, "K 3"],
    covariance: Float[np.ndarray, "K 3 3"],
    sigmas: Float[np.ndarray, "K 3"],
    seconds: Float[np.ndarray, " K"],
    errors: WheelErrors,
) -> Systematic:
    """Scale, gain, bend and drift at rest, by robust least squares of measured steps on counted ones.

    Args:
      counted: the wheels' steps, a_from_b.
      measured: the same steps, measured.
      covariance: of the measured ones.
      sigmas: of one counted step, its noise.
      seconds: how long each took.
      errors: what is expected before any measurement.
    """
    if len(counted) < 8:
        return Systematic()
    moved = np.linalg.norm(counted[:, :2], axis=1)
    driven = np.sum(measured[:, :2] * counted[:, :2], 1) / np.maximum(moved, 1e-9)
    noise = np.stack([covariance[:, 0, 0], sigmas[:, 0] ** 2])
    on = moved > AT_REST_M
    scale, scale_sigma = _fit(moved[on, None], driven[on], noise[:, on], np.ones(1), np.array([errors.scale_sigma]))
    rest = ~on & (np.abs(measured[:, 2]) < AT_REST_RAD) & (np.abs(counted[:, 2]) < AT_REST_RAD)
    design = np.stack([counted[:, 2], np.where(rest, 0, counted[:, 0]), np.where(rest, seconds, 0)], 1)
    noise = np.stack([covariance[:, 2, 2], sigmas[:, 2] ** 2])
    expected = np.array([errors.gain_sigma, np.radians(BEND_SIGMA_DEG), np.radians(errors.rest_deg_per_s)])
    turn, turn_sigma = _fit(design, measured[:, 2], noise, np.array([1.0, 0.0, 0.0]), expected)
    bend, drift = (float(np.degrees(value)) for value in turn[1:])
    sigma = float(scale_sigma[0]), float(turn_sigma[0]), *(float(np.degrees(s)) for s in turn_sigma[1:])
    return Systematic(float(scale[0]), float(turn[0]), bend, drift, sigma, len(counted))  # type: ignore[arg-type]


def _fit(
    design: Float[np.ndarray, "K d"],
    target: Float[np.ndarray, " K"],
    noise: Float[np.ndarray, "2 K"],
    mean: Float[np.ndarray, " d"],
    sigma: Float[np.ndarray, " d"],
) -> tuple[Float[np.ndarray, " d"], Float[np.ndarray, " d"]]:
    """Cauchy-reweighted least squares with a prior.

    The noise is a variance of the target and one of the design; the second is scaled down where residuals are smaller.
    """
    answer, information = mean.copy(), np.diag(sigma**-2.0)
    spread = 1.0
    for _ in range(30):
        residual = (target - design @ answer) / np.sqrt(noise[0] + spread**2 * noise[1])
        if len(residual):
            spread = float(np.clip(spread * np.median(np.abs(residual)) / 0.6745, 0.02, 1.0))
        variance = noise[0] + spread**2 * noise[1]
        weight = 1 / (variance + ((target - design @ answer) / 2.5) ** 2)
        information = np.diag(sigma**-2.0) + (design * weight[:, None]).T @ design
        answer = np.linalg.solve(information, (design * weight[:, None]).T @ target + mean / sigma**2)
    return answer, np.sqrt(np.diag(np.linalg.inv(information)))


def corrected(
    odom_from_base: Float[np.ndarray, "N 3"], seconds: Float[np.ndarray, " M"], wrong: Systematic
) -> Float[np.ndarray, "M 3"]:
    """The wheels' steps a_from_b, earlier from later, without what is wrong with all of them."""
    step = between(odom_from_base[:-1], odom_from_base[1:])
    moved = np.linalg.norm(step[:, :2], axis=1)
    rest = (moved < AT_REST_M) & (np.abs(step[:, 2]) < AT_REST_RAD)
    turn = wrong.gain * step[:, 2]
    turn += np.where(rest, np.radians(wrong.rest_deg_per_s) * seconds, np.radians(wrong.bend_deg_per_m) * step[:, 0])
    # What is turned more is turned on the way: the chord turns by half of it.
    half = (turn - step[:, 2]) / 2
    c, s = np.cos(half), np.sin(half)
    x, y = wrong.scale * step[:, 0], wrong.scale * step[:, 1]
    return np.stack([c * x - s * y, s * x + c * y, turn], 1)
