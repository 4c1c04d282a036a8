"""A home: cupboards and shelves along the walls, pictures on them, rooms painted differently: places differ.

NumPy; everything stands against a wall, out of the robot's way.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ebjax.floors.obstacles import Boxes, no_boxes
from ebjax.floors.plan import Plan

PAINTS = np.array(
    [
        [0.62, 0.61, 0.57],
        [0.42, 0.30, 0.20],
        [0.25, 0.36, 0.42],
        [0.52, 0.46, 0.25],
        [0.33, 0.42, 0.28],
        [0.50, 0.28, 0.24],
    ]
)
WOODS = np.array([[0.30, 0.17, 0.08], [0.55, 0.53, 0.48], [0.10, 0.06, 0.04], [0.38, 0.28, 0.15], [0.10, 0.16, 0.22]])


def furnish(plan: Plan, per_m: float, rng: np.random.Generator) -> tuple[Boxes, Float[np.ndarray, "S 3"]]:
    """Boxes along all walls, `per_m` a metre on average, and the paint of every wall.

    Args:
      plan: its walls have the floor on their left.
      per_m: pieces of furniture and pictures a metre of wall; 0 leaves the corridor bare.
      rng: of everything.
    """
    lengths = np.linalg.norm(plan.walls[:, 1] - plan.walls[:, 0], axis=1)
    if per_m == 0:
        return no_boxes(), np.tile(PAINTS[0], (len(lengths), 1))
    paints = PAINTS[rng.integers(len(PAINTS), size=len(lengths))]
    rows = []
    deepest = max(0.1, min(0.4, plan.width_m / 2 - 0.75))
    for (start, end), length in zip(plan.walls, lengths, strict=True):
        along = (end - start) / length
        left = np.array([-along[1], along[0]])
        at = rng.exponential(1 / per_m)
        while at < length - 0.3:
            picture = rng.uniform() < 0.4
            half = min(rng.uniform(0.15, 0.4) if picture else rng.uniform(0.2, 0.65), (length - at) / 2)
            depth = 0.02 if picture else rng.uniform(0.5, 1.0) * deepest
            bottom = rng.uniform(0.9, 1.3) if picture else 0.0
            top = bottom + rng.uniform(0.3, 0.7) if picture else rng.choice([0.45, 0.75, 0.95, 1.9])
            colours = rng.uniform(0.03, 0.7, (2, 3)) if picture else WOODS[rng.integers(len(WOODS), size=2)]
            centre = start + (at + half) * along + depth / 2 * left
            bands = rng.uniform(0.15, 0.5)
            rows.append([*centre, *along, half, depth / 2, bottom, top, *colours.reshape(-1), bands])
            at += 2 * half + rng.exponential(1 / per_m)
    table = np.array(rows).reshape(-1, 15)
    columns = (table[:, :2], table[:, 2:4], table[:, 4:6], table[:, 6], table[:, 7], table[:, 8:14].reshape(-1, 2, 3))
    return Boxes(*(jnp.asarray(n, jnp.float32) for n in (*columns, table[:, 14]))), paints
