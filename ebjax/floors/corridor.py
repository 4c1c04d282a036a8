"""A corridor: a textured floor, a ceiling, and upright walls with doors that repeat; where rays meet the walls.

World: z up, the floor is z = 0, metres. Reflectance is linear. Rays are lists of their three world components.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ebjax.floors import mipmap
from ebjax.floors.mipmap import Mipmap

CEILING_M = 2.6
SKIRTING_M = 0.11
DOOR_WIDTH_M, DOOR_HEIGHT_M, DOOR_FRAME_M = 0.9, 2.05, 0.06
LAMP_SPACING_M, LAMP_SIDE_M = 2.4, 0.6
WALL, SKIRTING, DOOR, FRAME, CEILING = (
    (0.62, 0.61, 0.57),
    (0.19, 0.17, 0.15),
    (0.115, 0.055, 0.032),
    (0.05, 0.025, 0.015),
    (0.75, 0.75, 0.73),
)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Corridor:
    """Walls as floor segments seen from their left, the floor's texture and where its corner lies."""

    walls: Float[Array, "S 2 2"]
    """Start and end of each wall, world x and y, m."""
    doors: Float[Array, "S 2"]
    """Position of one door along its wall and the spacing of the others, m; doors that do not fit are left out."""
    floor: Mipmap
    floor_origin: Float[Array, "2"]
    """World x and y of the outer corner of texel (0, 0), m."""
    texel_m: float = dataclasses.field(metadata=dict(static=True))


def straight_corridor(
    x_min: float, x_max: float, width_m: float, door_spacing_m: float, texture: Float[Array, "H W 3"], texel_m: float
) -> Corridor:
    """A box centred on y = 0: identical doors face each other along both sides, one door in the middle of each end."""
    y, dtype = width_m / 2, texture.dtype
    corners = jnp.array([[x_min, -y], [x_max, -y], [x_max, y], [x_min, y]], dtype)
    walls = jnp.stack([corners, jnp.roll(corners, -1, axis=0)], axis=1)
    length = x_max - x_min
    side, end = (length / 2, door_spacing_m), (y, 10 * width_m)
    doors = jnp.array([side, end, side, end], dtype)
    return Corridor(walls, doors, mipmap.build(texture), corners[0], texel_m)


def _covered(x: Float[Array, "H W"], low, high, footprint: Float[Array, "H W"]) -> Float[Array, "H W"]:
    """Share of the footprint centred on x that lies within [low, high]."""
    half = footprint / 2
    return jnp.clip((jnp.minimum(x + half, high) - jnp.maximum(x - half, low)) / footprint, 0, 1)


def _mix(
    colour: Float[Array, "*s 3"], other: tuple[float, float, float], share: Float[Array, "*s"]
) -> Float[Array, "*s 3"]:
    return colour + share[..., None] * (jnp.broadcast_to(jnp.array(other, colour.dtype), colour.shape) - colour)


def wall_colour(
    along, height, footprint_along, footprint_height, length, first_door, door_spacing
) -> Float[Array, "H W 3"]:
    """Plaster, skirting and the doors of one wall; positions and footprints in metres."""
    centre = first_door + door_spacing * jnp.round((along - first_door) / door_spacing)
    outer = DOOR_WIDTH_M / 2 + DOOR_FRAME_M
    fits = (centre - outer > 0) & (centre + outer < length)
    offset = along - centre

    def box(half_width: float, top: float) -> Float[Array, "H W"]:
        across = _covered(offset, -half_width, half_width, footprint_along)
        return fits * across * _covered(height, -1.0, top, footprint_height)

    colour = jnp.broadcast_to(jnp.array(WALL, along.dtype), (*along.shape, 3))
    colour = _mix(colour, SKIRTING, _covered(height, -1.0, SKIRTING_M, footprint_height))
    colour = _mix(colour, FRAME, box(outer, DOOR_HEIGHT_M + DOOR_FRAME_M))
    return _mix(colour, DOOR, box(DOOR_WIDTH_M / 2, DOOR_HEIGHT_M))


def lamps(x: Float[Array, "H W"], y: Float[Array, "H W"], blur: Float[Array, "H W"]) -> Float[Array, "H W"]:
    """Share of a blurred ceiling point that is lamp: square panels above y = 0, one every LAMP_SPACING_M."""
    offset = x - LAMP_SPACING_M * jnp.round(x / LAMP_SPACING_M)
    half = LAMP_SIDE_M / 2
    return jax.nn.sigmoid((half - jnp.abs(offset)) / blur) * jax.nn.sigmoid((half - jnp.abs(y)) / blur)


class Hit(NamedTuple):
    """Where each ray meets a wall: depth, which wall, its length, direction and normal . ray, and how far along it."""

    t: Float[Array, "H W"]
    wall: Int[Array, "H W"]
    length: Float[Array, "H W"]
    direction: Float[Array, "H W 2"]
    normal_ray: Float[Array, "H W"]
    along: Float[Array, "H W"]


def nearest_wall(walls: Float[Array, "S 2 2"], ray: list[Float[Array, "H W"]], origin: Float[Array, "3"]) -> Hit:
    """Crosses every wall's line in turn and keeps the nearest hit; t is infinite where there is none."""
    lengths = jnp.sqrt(jnp.sum((walls[:, 1] - walls[:, 0]) ** 2, axis=-1))
    directions = (walls[:, 1] - walls[:, 0]) / lengths[:, None]

    def cross(start, direction):
        ex, ey = direction[..., 0], direction[..., 1]
        normal_ray = ex * ray[1] - ey * ray[0]
        normal_ray = jnp.where(jnp.abs(normal_ray) < 1e-9, 1e-9, normal_ray)
        t = (ex * (start[..., 1] - origin[1]) - ey * (start[..., 0] - origin[0])) / normal_ray
        along = ex * (origin[0] + t * ray[0] - start[..., 0]) + ey * (origin[1] + t * ray[1] - start[..., 1])
        return t, along, normal_ray

    nearest = jnp.full_like(ray[0], jnp.inf)
    wall = jnp.zeros(ray[0].shape, jnp.int32)
    for i in range(walls.shape[0]):
        t, along, _ = cross(walls[i, 0], directions[i])
        # A tenth of a millimetre of overlap, so that no ray slips out between two walls.
        closer = (t > 0) & (along >= -1e-4) & (along <= lengths[i] + 1e-4) & (t < nearest)
        nearest, wall = jnp.where(closer, t, nearest), jnp.where(closer, i, wall)
    t, along, normal_ray = cross(walls[wall, 0], directions[wall])
    return Hit(jnp.where(jnp.isfinite(nearest), t, nearest), wall, lengths[wall], directions[wall], normal_ray, along)


def corner_shade(walls: Float[Array, "S 2 2"], x: Float[Array, "H W"], y: Float[Array, "H W"]) -> Float[Array, "H W"]:
    """Darkening of the floor close to the lines of the walls."""
    shade = jnp.ones_like(x)
    for start, end in walls:
        ex, ey = (end - start) / jnp.sqrt(jnp.sum((end - start) ** 2))
        clearance = jnp.abs(ex * (y - start[1]) - ey * (x - start[0]))
        shade = shade * (1 - 0.3 * jnp.exp(-clearance / 0.12))
    return shade
