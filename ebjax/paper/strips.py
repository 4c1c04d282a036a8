"""Synthetic floors as photographs from above, to be cropped as real ones are."""

import numpy as np
from jaxtyping import UInt8

from ebjax.floors.robot import RobotConfig
from ebjax.floors.sequence import CorridorConfig, record
from ebjax.floors.sheet import from_above
from ebjax.floors.surface import FAMILIES, FloorConfig

LENGTH_M, WIDTH_M, EACH = 3.0, 2.3, 2
PIXELS = (1024, 785)


def strips(seed: int) -> dict[str, UInt8[np.ndarray, "_ _ 3"]]:
    """EACH floors of every family, LENGTH_M x WIDTH_M, under even light."""
    found = {}
    for name in FAMILIES:
        if name == "photograph":
            continue
        for k in range(EACH):
            config = CorridorConfig(
                seed=seed + k, floor=FloorConfig(family=name), robot=RobotConfig(distance_m=LENGTH_M, step_m=1.0)
            )
            scene = record(config).scene
            found[f"{name} {k + 1}"] = from_above(scene, (LENGTH_M / 2, 0.0), LENGTH_M, *PIXELS)
    return found
