"""A contact sheet: families of floors from above, near and far, and from both directions under two lights.

Those that floornet has learned from.
"""

import cv2
import jax.numpy as jnp
import numpy as np
from jaxtyping import UInt8

from ebjax.floors.atlas import locate, look
from ebjax.floors.robot import RobotConfig
from ebjax.floors.scene import Scene
from ebjax.floors.sensor import GAMMA
from ebjax.floors.sequence import CorridorConfig, record
from ebjax.floors.surface import LEARNED, FloorConfig

CELL = (320, 240)
FROM_ABOVE = 4.0


def from_above(
    scene: Scene, centre: tuple[float, float], metres: float, width: int, height: int
) -> UInt8[np.ndarray, "h w 3"]:
    """A piece of floor under even light, `metres` across."""
    scale = metres / width
    u, v = jnp.meshgrid(jnp.arange(width) - width / 2, jnp.arange(height) - height / 2)
    x, y = (centre[0] + u * scale).astype(jnp.float32), (centre[1] - v * scale).astype(jnp.float32)
    axes = jnp.broadcast_to(jnp.array([[scale, 0.0], [0.0, -scale]], jnp.float32), (height, width, 2, 2))
    floor = look(scene.floor, locate(scene.floor, x, y), axes)[..., :3]
    return np.asarray(jnp.round(255 * jnp.clip(floor, 0, 1) ** (1 / GAMMA))).astype(np.uint8)


def sheet(seed: int) -> UInt8[np.ndarray, "h w 3"]:
    """A row a family: 2.4 m from above, 0.8 m from above, the way out, the same floor on the way back."""
    rows = []
    for number, name in enumerate(LEARNED):
        config = CorridorConfig(
            seed=seed + number, floor=FloorConfig(family=name), robot=RobotConfig(distance_m=FROM_ABOVE, step_m=0.2)
        )
        run = record(config)
        middle = (FROM_ABOVE / 2, 0.0)
        # Facing robots see one patch from 2.4 m apart.
        x = run.world_from_base[:, 0, 3]
        half = len(run) // 2
        out, back = np.argmin(np.abs(x[:half] - 0.8)), half + np.argmin(np.abs(x[half:] - 3.2))
        cells = [from_above(run.scene, middle, 2.9, *CELL), from_above(run.scene, middle, 0.8, *CELL)]
        cells += [cv2.resize(run.frame(int(i))[0], CELL, interpolation=cv2.INTER_AREA) for i in (out, back)]
        cv2.putText(cells[0], name, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (0, 0, 0), 3, cv2.LINE_AA)
        cv2.putText(cells[0], name, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (255, 255, 255), 1, cv2.LINE_AA)
        rows.append(np.hstack(cells))
    return np.vstack(rows)
