"""The Lie groups that a pose graph can live on, by name."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ebjax.geometry import se2, se3


class Group(NamedTuple):
    """What a pose graph needs of a Lie group: `size` numbers a pose, `dim` numbers a tangent.

    `bracket[k, l]` is [e_k, e_l], the structure constants.
    """

    size: int
    dim: int
    compose: Callable
    inverse: Callable
    exp: Callable
    log: Callable
    adjoint: Callable
    log_jacobian: Callable
    log_jacobian_turn: Callable
    normalise: Callable
    identity: tuple[float, ...]
    bracket: np.ndarray


_SE2 = (se2.compose, se2.inverse, se2.exp, se2.log, se2.adjoint, se2.log_jacobian, se2.log_jacobian_turn, se2.normalise)
_SE3 = (se3.compose, se3.inverse, se3.exp, se3.log, se3.adjoint, se3.log_jacobian, se3.log_jacobian_turn, se3.normalise)
GROUPS = {
    "se2": Group(3, 3, *_SE2, (0.0, 0.0, 0.0), se2.bracket()),
    "se3": Group(7, 6, *_SE3, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), se3.bracket()),
}
