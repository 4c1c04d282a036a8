"""What stands around the floor: upright walls with doors that repeat and skirting, a ceiling of panels and lamps.

World: z up, the floor is z = 0 but for a ramp, metres. Reflectance is linear. Rays are lists of their three world
components.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ebjax.floors.atlas import Atlas
from ebjax.floors.obstacles import Boxes
from ebjax.floors.plan import Plan
from ebjax.floors.ramp import Ramp

CEILING_M = 2.6
SKIRTING_M = 0.11
DOOR_WIDTH_M, DOOR_HEIGHT_M, DOOR_FRAME_M = 0.9, 2.05, 0.06
SILL_M = 0.9
PANEL_M, PANEL_GAP_M = 0.6, 0.02
LAMP_SPACING_M, LAMP_SIDE_M = 2.4, 0.58
WALL, SKIRTING, DOOR, FRAME, CEILING, GRID = (
    (0.62, 0.61, 0.57),
    (0.19, 0.17, 0.15),
    (0.115, 0.055, 0.032),
    (0.05, 0.025, 0.015),
    (0.75, 0.75, 0.73),
    (0.35, 0.35, 0.34),
)
Plane = Float[Array, "H W"]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Scene:
    """Walls as floor segments with the floor on their left, the floor, and what does not move on it."""

    walls: Float[Array, "S 2 2"]
    """Start and end of each wall, world x and y, m."""
    wall_colours: Float[Array, "S 3"]
    doors: Float[Array, "S 2"]
    """Position of one door along its wall and the spacing of the others, m; doors that do not fit are left out."""
    floor: Atlas
    furniture: Boxes
    """Heights are above the floor."""
    ramp: Ramp | None = None
    lamp_m: Float[Array, "3"] | None = None
    """Spacing, length and width of the lamps; None: square panels."""


def make_scene(
    plan: Plan,
    floor: Atlas,
    door_spacing_m: float,
    furniture: Boxes,
    wall_colours: Float[np.ndarray, "S 3"] | None = None,
    ramp: Ramp | None = None,
    lamp_m: tuple[float, float, float] | None = None,
) -> Scene:
    """Walls of one plaster unless told otherwise, identical doors along them; the dtype is the floor's."""
    dtype = floor.lengths.dtype
    lengths = np.linalg.norm(plan.walls[:, 1] - plan.walls[:, 0], axis=1)
    doors = np.stack([lengths / 2, np.full_like(lengths, door_spacing_m)], axis=1)
    colours = np.tile(WALL, (len(lengths), 1)) if wall_colours is None else wall_colours
    return Scene(
        jnp.asarray(np.asarray(plan.walls, dtype)),
        jnp.asarray(np.asarray(colours, dtype)),
        jnp.asarray(np.asarray(doors, dtype)),
        floor,
        furniture,
        jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf, dtype)), ramp),
        None if lamp_m is None else jnp.asarray(np.asarray(lamp_m, dtype)),
    )


def covered(x: Plane, low, high, footprint: Plane) -> Plane:
    """Share of the footprint centred on x that lies within [low, high]."""
    half = footprint / 2
    return jnp.clip((jnp.minimum(x + half, high) - jnp.maximum(x - half, low)) / footprint, 0, 1)


def _mix(colour: Float[Array, "H W 3"], other: tuple[float, float, float], share: Plane) -> Float[Array, "H W 3"]:
    return colour + share[..., None] * (jnp.broadcast_to(jnp.array(other, colour.dtype), colour.shape) - colour)


def wall_colour(
    plaster, along, height, footprint_along, footprint_height, length, first_door, door_spacing
) -> Float[Array, "H W 3"]:
    """Plaster, skirting and the doors of one wall; positions and footprints in metres."""
    centre = first_door + door_spacing * jnp.round((along - first_door) / door_spacing)
    outer = DOOR_WIDTH_M / 2 + DOOR_FRAME_M
    fits = (centre - outer > 0) & (centre + outer < length)
    offset = along - centre

    def box(half_width: float, top: float) -> Plane:
        across = covered(offset, -half_width, half_width, footprint_along)
        return fits * across * covered(height, -1.0, top, footprint_height)

    colour = _mix(plaster, SKIRTING, covered(height, -1.0, SKIRTING_M, footprint_height))
    colour = _mix(colour, FRAME, box(outer, DOOR_HEIGHT_M + DOOR_FRAME_M))
    return _mix(colour, DOOR, box(DOOR_WIDTH_M / 2, DOOR_HEIGHT_M))


def window_panes(along, height, footprint_along, footprint_height, length, first_door, door_spacing) -> Plane:
    """Share of a wall's point that is window: one between two doors, as wide as a door, from sill to lintel."""
    nearest = jnp.round((along - first_door) / door_spacing - 0.5) + 0.5
    centre = first_door + door_spacing * nearest
    fits = (centre - DOOR_WIDTH_M / 2 > 0) & (centre + DOOR_WIDTH_M / 2 < length)
    across = covered(along - centre, -DOOR_WIDTH_M / 2, DOOR_WIDTH_M / 2, footprint_along)
    return fits * across * covered(height, SILL_M, DOOR_HEIGHT_M, footprint_height)


def lamps(along: Plane, across: Plane, blur: Plane, size: Float[Array, "3"] | None = None) -> Plane:
    """Share of a blurred ceiling point that is lamp: rectangles above a corridor's middle.

    Args:
      along: where the point is, m.
      across: from the middle, m.
      blur: m.
      size: spacing, length, width, m; None: square panels, one every 2.4 m.
    """
    spacing, length, width = (LAMP_SPACING_M, LAMP_SIDE_M, LAMP_SIDE_M) if size is None else size
    offset = along - spacing * jnp.round(along / spacing)
    within = jax.nn.sigmoid((length / 2 - jnp.abs(offset)) / blur)
    return within * jax.nn.sigmoid((width / 2 - jnp.abs(across)) / blur)


def ceiling(
    along: Plane, across: Plane, footprint: Plane, lamp: float, size: Float[Array, "3"] | None = None
) -> Float[Array, "H W 3"]:
    """Panels in a grid, and the lamps' radiance."""
    gaps = jnp.zeros_like(along)
    for x in (along, across + PANEL_M / 2):
        offset = x - PANEL_M * jnp.round(x / PANEL_M - 0.5) - PANEL_M / 2
        gaps = jnp.maximum(gaps, covered(offset, -PANEL_GAP_M / 2, PANEL_GAP_M / 2, footprint))
    panels = _mix(jnp.broadcast_to(jnp.array(CEILING, along.dtype), (*along.shape, 3)), GRID, gaps)
    return _mix(panels, (lamp, lamp, lamp), lamps(along, across, 0.004 + 0.3 * footprint, size))


class Hit(NamedTuple):
    """Where each ray meets a wall: depth, which wall, its length, direction and normal . ray, and how far along it."""

    t: Plane
    wall: Int[Array, "H W"]
    length: Plane
    direction: Float[Array, "H W 2"]
    normal_ray: Plane
    along: Plane


def nearest_wall(walls: Float[Array, "S 2 2"], ray: list[Plane], origin: Float[Array, "3 *rows"]) -> Hit:
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

    # Loops and barriers: what many readers fuse with, XLA computes again for each of them.
    def step(seen, number):
        nearest, wall = seen
        t, along, _ = cross(walls[number, 0], directions[number])
        # A tenth of a millimetre of overlap, so that no ray slips out between two walls.
        closer = (t > 0) & (along >= -1e-4) & (along <= lengths[number] + 1e-4) & (t < nearest)
        return (jnp.where(closer, t, nearest), jnp.where(closer, number, wall)), None

    start = jnp.full_like(ray[0], jnp.inf), jnp.zeros(ray[0].shape, jnp.int32)
    (nearest, wall), _ = jax.lax.scan(step, start, jnp.arange(len(walls), dtype=jnp.int32))
    nearest, wall = jax.lax.optimization_barrier((jax.lax.stop_gradient(nearest), wall))
    t, along, normal_ray = cross(walls[wall, 0], directions[wall])
    return Hit(jnp.where(jnp.isfinite(nearest), t, nearest), wall, lengths[wall], directions[wall], normal_ray, along)
