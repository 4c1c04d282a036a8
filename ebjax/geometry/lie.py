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
    left_tangent: Callable
    normalise: Callable
    identity: tuple[float, ...]
    bracket: np.ndarray


def _group(module, identity):
    names = ("compose", "inverse", "exp", "log", "adjoint", "log_jacobian", "log_jacobian_turn", "left_tangent")
    functions = {name: getattr(module, name) for name in (*names, "normalise")}
    bracket = module.bracket()
    return Group(size=len(identity), dim=len(bracket), identity=identity, bracket=bracket, **functions)


GROUPS: dict[str, Group] = {
    "se2": _group(se2, (0.0, 0.0, 0.0)),
    "se3": _group(se3, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
}
