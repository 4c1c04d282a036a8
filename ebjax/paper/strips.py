"""Synthetic floors as photographs from above under even light, to be cropped as real ones are.

Even light shows no relief: of a carpet only the yarns' colours are seen.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import UInt8

from ebjax.floors.atlas import locate, look
from ebjax.floors.laying import floor_of
from ebjax.floors.robot import RobotConfig
from ebjax.floors.sensor import GAMMA
from ebjax.floors.sequence import CorridorConfig, plan_of
from ebjax.floors.surface import LEARNED, FloorConfig

LENGTH_M, EACH = 3.0, 2
SIZE_PX = (768, 1024)


def strips(seed: int) -> dict[str, UInt8[np.ndarray, "_ _ 3"]]:
    """EACH floors of every family that floornet has learned, LENGTH_M long, of SIZE_PX."""
    return {f"{name} {k + 1}": strip(FloorConfig(family=name), seed + k) for name in LEARNED for k in range(EACH)}


def strip(floor: FloorConfig, seed: int) -> UInt8[np.ndarray, "_ _ 3"]:
    """The middle of a corridor with such a floor."""
    plan = plan_of(CorridorConfig(floor=floor, robot=RobotConfig(distance_m=LENGTH_M)))
    laid = floor_of(plan, floor, key=jax.random.key(seed))
    height, width = SIZE_PX
    scale = LENGTH_M / width
    u, v = jnp.meshgrid(jnp.arange(width, dtype=jnp.float32), jnp.arange(height, dtype=jnp.float32))
    ground = locate(laid, (u + 0.5) * scale, (height / 2 - 0.5 - v) * scale)
    by_pixel = jnp.broadcast_to(jnp.array([[scale, 0.0], [0.0, -scale]], jnp.float32), (height, width, 2, 2))
    linear = np.asarray(look(laid, ground, by_pixel))[..., :3]
    return np.round(255 * np.clip(linear, 0, 1) ** (1 / GAMMA)).astype(np.uint8)
