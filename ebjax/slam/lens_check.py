"""Whether the floor views would agree better through another lens than the one that the camera is said to have."""

import dataclasses
from collections.abc import Iterable

import numpy as np
from jaxtyping import Int

from ebjax.geometry.camera import Camera
from ebjax.geometry.lens import lens
from ebjax.slam.lean import PAIRS, Asked

LENSES = (("plumb_bob", (-0.25, 0.06, 0.0, 0.0)), ("equidistant", (0.0, 0.0, 0.0, 0.0)))
"""Those of cameras that are often taken for pinholes: a barrel, a fisheye."""
CLEARLY = 1.25
FEWEST = 100
"""Matches below which nothing is said."""


def lens_warning(asked: Asked, cameras: Iterable[Camera], frames: Int[np.ndarray, " N"]) -> str | None:
    """Names the lens through which successive floor views agree clearly better; None where there is none.

    Args:
      asked: what views are made with.
      cameras: that are believed, all of one lens; the best of them counts.
      frames: of the keyframes.
    """
    firsts = np.unique(np.linspace(0, len(frames) - 2, PAIRS).round().astype(int))
    pairs = [(int(frames[k + 1]), int(frames[k])) for k in firsts]
    believed = max(asked.agree(pairs, camera=camera) for camera in cameras)
    counts = []
    for model, coefficients in LENSES:
        try:
            counts.append(asked.agree(pairs, camera=dataclasses.replace(asked.camera, lens=lens(model, coefficients))))
        except ValueError:  # through this lens the camera sees no floor
            counts.append(0)
    best = int(np.argmax(counts))
    if counts[best] < max(FEWEST, CLEARLY * believed):
        return None
    model, coefficients = LENSES[best]
    return (
        f"the camera is said to be a {asked.camera.lens.model}, but successive floor views agree better through a lens "
        f"that bends ({counts[best]} matches through {model} {list(coefficients)}, {believed} without): calibrate the "
        "lens and give it with --camera FILE"
    )
