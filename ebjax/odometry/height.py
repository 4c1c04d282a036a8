"""The camera's height and how far ahead it stands, from what wheels or depth say beside the floor's steps.

A wrong height only scales the floor's steps, as a wrong scale of the wheels does: the two are told apart by how well
each is known. A camera that stands x ahead of where it is thought to swings aside in turns.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

PRIOR_M = 0.02
"""Standard deviation of height and x as given, m."""
DEPTH_SHARE = 0.01
"""Standard deviation of the scale of a depth camera."""
SLIP_M_PER_RAD = 0.05
"""How far a robot's wheels may slip aside while it turns."""
SIGNIFICANT = 2.5
"""What lies within so many standard deviations of the given value stays as given."""
ALARM = 0.05
"""A height that wheels or depth contradict by a larger share is warned of."""


@dataclasses.dataclass(frozen=True)
class Reach:
    """What height and x were found to be off by, m, with standard deviations."""

    height_m: float = 0.0
    x_m: float = 0.0
    height_sigma_m: float = PRIOR_M
    x_sigma_m: float = PRIOR_M

    def significant(self) -> "Reach":
        """Without what may as well be nothing."""
        return dataclasses.replace(
            self,
            height_m=self.height_m * (abs(self.height_m) > SIGNIFICANT * self.height_sigma_m),
            x_m=self.x_m * (abs(self.x_m) > SIGNIFICANT * self.x_sigma_m),
        )


def height_from_wheels(
    height_m: float, driven_per_counted: float, sigma: float, scale_sigma: float
) -> tuple[float, float]:
    """What is to be added to the height, m, and its standard deviation.

    log(measured / counted) = log(given / true height) + log(driven / counted by the wheels); both have priors.

    Args:
      height_m: as given.
      driven_per_counted: the floor's metres per metre of the wheels, under that height.
      sigma: its standard deviation.
      scale_sigma: of the wheels' scale, as declared.
    """
    prior = (PRIOR_M / height_m) ** 2
    other = scale_sigma**2 + sigma**2
    found = -np.log(driven_per_counted) * prior / (prior + other)
    return float(height_m * np.expm1(found)), float(height_m * np.sqrt(prior * other / (prior + other)))


def height_from_depth(height_m: float, floor_z_m: Float[np.ndarray, " N"]) -> tuple[float, float]:
    """The same from the heights (z in base, m) at which depth sees the floor."""
    z = float(np.median(floor_z_m))
    prior, other = PRIOR_M**2, (DEPTH_SHARE * height_m) ** 2
    share = prior / (prior + other)
    return -z * share, float(np.sqrt(other * share))


def x_from_turns(
    measured: Float[np.ndarray, "K 3"], counted: Float[np.ndarray, "K 3"], sigmas: Float[np.ndarray, "K 3"]
) -> tuple[float, float]:
    """What is to be added to x, m, and its standard deviation.

    A camera that stands e ahead of where it is thought to sees a step that turns by R move by (R - I) e more.

    Args:
      measured: steps earlier_from_later, by the camera.
      counted: the same by the wheels.
      sigmas: standard deviation (x, y) of the difference, in the first two columns.
    """
    c, s = np.cos(counted[:, 2]), np.sin(counted[:, 2])
    sigmas = np.hypot(sigmas, SLIP_M_PER_RAD * np.abs(counted[:, 2:]))
    design = np.stack([c - 1, s], 1)
    difference = measured[:, :2] - counted[:, :2]
    answer, information = 0.0, PRIOR_M**-2.0
    for _ in range(10):
        residual = (difference - design * answer) / sigmas[:, :2]
        weight = 1 / ((1 + residual**2 / 9) * sigmas[:, :2] ** 2)
        information = PRIOR_M**-2.0 + float(np.sum(weight * design**2))
        answer = float(np.sum(weight * design * difference)) / information
    return answer, float(information**-0.5)
