"""A ramp in the floor: how high the floor is, where rays meet it, and how a robot stands on it.

The floor is z = 0 up to the ramp's foot, climbs evenly to its top and stays that high beyond. Foot and top are straight
lines across the whole world. Ceiling, doors, furniture and people keep their heights above the floor. World x and y
are the plan's: tiles on the ramp are longer by 1 / cos(slope).
"""

import typing

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ebjax.floors.plan import PlanConfig, polyline
from ebjax.geometry.pytree import pytree

TRACK_M, CASTER_M = 0.33, 0.22
"""A P3DX: between its two wheels, and from their axis back to the caster."""
MOST_DEG = 20.0
Plane = Float[Array, "H W"]


@pytree
class Ramp:
    """Where the floor climbs; the leaves are NumPy's or JAX's."""

    foot: Float[Array | np.ndarray, "2"]
    direction: Float[Array | np.ndarray, "2"]
    """Unit vector from foot to top, on the plan."""
    length_m: Float[Array | np.ndarray, ""]
    """From foot to top, on the plan."""
    slope: Float[Array | np.ndarray, ""]
    """Rise over length; below 0 the ramp goes down."""

    def along(self, x, y):
        """Distance beyond the foot on the plan, m."""
        return (x - self.foot[0]) * self.direction[0] + (y - self.foot[1]) * self.direction[1]

    def height(self, x, y):
        """Height of the floor, m."""
        return self.slope * self.along(x, y).clip(0, self.length_m)


def make_ramp(config: PlanConfig) -> Ramp | None:
    """The plan's ramp in float64, or None.

    Raises:
      ValueError: one that cannot be; names the key.
    """
    if not abs(config.ramp_deg) <= MOST_DEG:
        raise ValueError(f"plan.ramp_deg is {config.ramp_deg}: needs a value from {-MOST_DEG:g} to {MOST_DEG:g}")
    if not config.ramp and config.ramp_deg:
        raise ValueError('plan.ramp is "": plan.ramp_deg needs its foot and its top, "x y, x y"')
    if not config.ramp:
        return None
    if not config.ramp_deg:
        raise ValueError("plan.ramp_deg is 0: needs the slope of plan.ramp")
    ends = polyline(config.ramp, "plan.ramp")
    if len(ends) != 2:
        raise ValueError(f'plan.ramp is {config.ramp!r}: needs two points "x y, x y", the foot and the top')
    length = np.linalg.norm(ends[1] - ends[0])
    slope = np.tan(np.radians(config.ramp_deg))
    return Ramp(ends[0], (ends[1] - ends[0]) / length, np.asarray(length), np.asarray(slope))


def stand(poses: Float[np.ndarray, "*s 3"], ramp: Ramp | None) -> Float[np.ndarray, "*s 4 4"]:
    """Poses (x, y, heading) of a base as matrices: on the floor with both wheels and the caster, tilted as they stand.

    The wheels' axis is above (x, y). Where axis and caster are on different sides of the ramp's foot or top, the tilt
    is between both floors', and so the camera sees the floor ahead tilted.
    """
    x, y, heading = np.moveaxis(poses, -1, 0)
    c, s = np.cos(heading), np.sin(heading)
    matrices = np.zeros((*x.shape, 4, 4))
    matrices[...] = np.eye(4)
    matrices[..., 0, 0], matrices[..., 0, 1], matrices[..., 1, 0], matrices[..., 1, 1] = c, -s, s, c
    matrices[..., :2, 3] = poses[..., :2]
    if ramp is None:
        return matrices
    half = TRACK_M / 2
    left, right = ramp.height(x - half * s, y + half * c), ramp.height(x + half * s, y - half * c)
    caster, middle = ramp.height(x - CASTER_M * c, y - CASTER_M * s), (left + right) / 2
    forward = _unit(np.stack([CASTER_M * c, CASTER_M * s, middle - caster], axis=-1))
    up = _unit(np.cross(forward, np.stack([-TRACK_M * s, TRACK_M * c, left - right], axis=-1)))
    matrices[..., :3, :3] = np.stack([forward, np.cross(up, forward), up], axis=-1)
    matrices[..., 2, 3] = middle
    return matrices


def _unit(vectors: Float[np.ndarray, "*s 3"]) -> Float[np.ndarray, "*s 3"]:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


class Level(typing.NamedTuple):
    """Where each ray meets floor or ceiling: its parameter, whether it goes down to the floor, and how that lies."""

    t: Plane
    down: Bool[Array, "H W"]
    rise: Plane
    """Growth of the ray's height above the surface that it meets."""
    normal: list[Plane | float]
    """(-dz/dx, -dz/dy, 1) of that surface."""


def see_level(ramp: Ramp | None, ray: list[Plane], origin: Float[Array, "3 *rows"], ceiling_m: float) -> Level:
    """Crosses every ray with floor and ceiling; t is infinite where a ramp's three pieces are all missed."""
    if ramp is None:
        t, down = _cross(origin[2], ray[2], ceiling_m)
        return Level(t, down, ray[2], [0.0, 0.0, 1.0])
    start = ramp.along(origin[0], origin[1])
    along = ramp.direction[0] * ray[0] + ramp.direction[1] * ray[1]
    zero, top = jnp.zeros_like(ramp.slope), ramp.slope * ramp.length_m
    found = Level(
        jnp.full_like(along, jnp.inf), ray[2] < 0, ray[2], [jnp.zeros_like(along), jnp.zeros_like(along), 1.0]
    )
    for slope, base, low, high in (
        (zero, zero, -jnp.inf, 0.0),
        (ramp.slope, zero, 0.0, ramp.length_m),
        (zero, top, ramp.length_m, jnp.inf),
    ):
        rise = ray[2] - slope * along
        t, down = _cross(origin[2] - base - slope * start, rise, ceiling_m)
        at = start + jax.lax.stop_gradient(t) * along
        # A tenth of a millimetre of overlap, so that no ray slips out between two pieces.
        nearer = (t > 0) & (at >= low - 1e-4) & (at <= high + 1e-4) & (t < found.t)
        normal = [jnp.where(nearer, -slope * ramp.direction[i], found.normal[i]) for i in (0, 1)]
        new = [jnp.where(nearer, n, o) for n, o in zip((t, down, rise), found[:3], strict=True)]
        found = Level(new[0], new[1], new[2], [*normal, 1.0])
    return found


def _cross(height, rise: Plane, ceiling_m: float) -> tuple[Plane, Bool[Array, "H W"]]:
    """Parameter at which rays that start at a height meet the floor below or the ceiling, and which it is."""
    down = rise < 0
    upright = jnp.where(jnp.abs(rise) < 1e-9, 1e-9, rise)
    return jnp.where(down, -height, ceiling_m - height) / upright, down
