"""Verification of pairs of a run's keyframes, whatever side each looks from."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int

from ebjax.features.extractor import Extractor
from ebjax.features.landmarks import Landmarks, take
from ebjax.features.verify_pairs import Found, verify_blocks
from ebjax.geometry.camera import Camera
from ebjax.slam.describe import Described
from ebjax.views.run_view import RunView


def verify_pairs(
    described: Described,
    chosen: Extractor,
    view: RunView,
    camera: Camera,
    i: Int[np.ndarray, " K"],
    j: Int[np.ndarray, " K"],
    opposing: Bool[np.ndarray, " K"],
    *,
    tolerance_m: float,
    seed: int,
) -> Found:
    """Verifies and measures pairs of keyframes, rows of `described`; see `verify_blocks`."""

    def pick(a, b, facing):
        return take(described.landmarks, a), seen_from(described, chosen, b, facing)

    return verify_blocks(pick, view, camera, i, j, opposing, tolerance_m=tolerance_m, seed=seed)


def seen_from(
    described: Described, chosen: Extractor, rows: Int[np.ndarray, " K"], facing: Bool[np.ndarray, " K"]
) -> Landmarks:
    """The landmarks of keyframes, as a view in the same direction has them or, where `facing`, the opposite one."""
    straight = take(described.landmarks, rows)
    if chosen.turn is None:
        assert described.turned is not None
        turned = take(described.turned, rows)
    else:
        descriptors = chosen.turn(jnp.asarray(straight.features.descriptors))
        turned = dataclasses.replace(straight, features=dataclasses.replace(straight.features, descriptors=descriptors))
    return jax.tree.map(lambda s, t: np.where(facing.reshape(-1, *(1,) * (s.ndim - 1)), t, s), straight, turned)
