"""What a polished floor shows besides itself: walls, doors, windows and lamps, upside down, farther than the floor.

A ray from the camera that meets the floor at p goes on as it came, but upwards: after s metres over the ground it is
s h / R high, for a camera h above the floor and R metres from p. It meets a side wall, the far end or the ceiling. What
a floor mirrors of that grows towards grazing rays (Schlick 1994: F = F0 + (1 - F0)(1 - cos)^5) and is the softer the
rougher the floor is and the longer the way, more so along the ray than across. It stands where the camera stands: the
next view of the same floor has other mirror images, those of another floor may have the same.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from ebjax.geometry.pytree import pytree

F0 = 0.04
Plane = Float[Array, "H W"]


@pytree
class Room:
    """Of one floor; metres, and radiance against that of a floor of middling grey."""

    ceiling_m: Float[Array, ""]
    walls_m: Float[Array, "2"]
    """How far away that on the left and that on the right are."""
    end_m: Float[Array, ""]
    wall: Float[Array, ""]
    doors: Float[Array, "3"]
    """Spacing, width, radiance."""
    windows: Float[Array, "4"]
    """In the left wall: spacing, width, sill, radiance."""
    lamps: Float[Array, "5"]
    """Spacing, length, width, how far aside, radiance."""
    far: Float[Array, "2"]
    """Half width of the opening at the end, radiance."""
    rough: Float[Array, ""]
    """Of the floor: softness of a mirror image a metre of way."""
    polish: Float[Array, ""]
    """0: mirrors nothing."""


def _between(draw: Float[Array, ""], low: float, high: float) -> Float[Array, ""]:
    return low + (high - low) * draw


def _evenly(draw: Float[Array, ""], low: float, high: float) -> Float[Array, ""]:
    """Evenly by its logarithm."""
    return jnp.exp(_between(draw, float(np.log(low)), float(np.log(high))))


def draw_room(share: float, *, key: Key[Array, ""]) -> Room:
    """A corridor, a room or a hall.

    Args:
      share: of rooms whose floor mirrors.
      key: of everything random.
    """
    d = jax.random.uniform(key, (24,), jnp.float32)
    lit, sunny, open_end = d[0] < 0.75, d[1] < 0.5, d[2] < 0.5
    return Room(
        ceiling_m=_between(d[3], 2.2, 4.0),
        walls_m=jnp.stack([_evenly(d[4], 0.7, 8.0), _evenly(d[5], 0.7, 8.0)]),
        end_m=_evenly(d[6], 3.0, 40.0),
        wall=_between(d[7], 0.1, 0.9),
        doors=jnp.stack([_between(d[8], 1.5, 6.0), _between(d[9], 0.7, 1.3), _between(d[10], 0.02, 0.6)]),
        windows=jnp.stack(
            [
                _between(d[11], 1.2, 5.0),
                _between(d[12], 0.5, 1.1),
                d[13],
                jnp.where(sunny, _evenly(d[14], 1.0, 15.0), 0),
            ]
        ),
        lamps=jnp.stack(
            [
                _between(d[15], 1.2, 4.0),
                _evenly(d[16], 0.1, 1.6),
                _evenly(d[17], 0.1, 1.0),
                _between(d[18], -1.2, 1.2),
                jnp.where(lit, _evenly(d[19], 2.0, 15.0), 0),
            ]
        ),
        far=jnp.stack([_between(d[20], 0.4, 2.0), jnp.where(open_end, _evenly(d[21], 1.0, 15.0), 0.3)]),
        rough=_evenly(d[22], 0.01, 0.3),
        polish=jnp.where(d[23] < share, _between(d[23] / max(share, 1e-6), 0.1, 1.0), 0),
    )


def _within(x: Plane, half: Float[Array, ""], soft: Plane) -> Plane:
    """How much of a soft point lies within `half` of 0."""
    return jax.nn.sigmoid((half - jnp.abs(x)) / soft) * jax.nn.sigmoid((half + jnp.abs(x)) / soft)


def _nearest(x: Plane, spacing: Float[Array, ""]) -> Plane:
    return x - spacing * jnp.round(x / spacing)


def mirrored(
    room: Room,
    at_m: tuple[Plane, Plane],
    height_m: Float[Array, ""],
    heading: Float[Array, ""],
    along_m: Float[Array, ""],
) -> Plane:
    """Radiance that the floor adds to its own.

    Args:
      room: around.
      at_m: the floor's points, to the right of the camera's foot and ahead of it.
      height_m: of the camera.
      heading: against the corridor's axis, rad.
      along_m: how far the camera is down the corridor.
    """
    c, s = jnp.cos(heading), jnp.sin(heading)
    across, ahead = c * at_m[0] + s * at_m[1], c * at_m[1] - s * at_m[0]
    reach = jnp.sqrt(across**2 + ahead**2)
    side, forward, climb = across / reach, ahead / reach, height_m / reach
    cosine = climb / jnp.sqrt(1 + climb**2)
    fresnel = F0 + (1 - F0) * (1 - cosine) ** 5

    aside = jnp.where(side < 0, room.walls_m[0], room.walls_m[1])
    to_side = jnp.maximum(aside - jnp.abs(across), 0.05) / jnp.maximum(jnp.abs(side), 1e-3)
    to_end = jnp.maximum(room.end_m - ahead, 0.05) / jnp.maximum(forward, 1e-3)
    to_ceiling = room.ceiling_m / climb
    to_wall = jnp.minimum(to_side, to_end)

    def soft(way: Plane) -> Plane:
        return 0.01 + room.rough * (reach + way)

    high, blur = to_wall * climb, soft(to_wall)
    x = along_m + ahead + to_wall * forward
    door = _within(_nearest(x, room.doors[0]), room.doors[1] / 2, blur) * jax.nn.sigmoid((2.05 - high) / blur)
    skirting = 1 - 0.7 * jax.nn.sigmoid((0.1 - high) / (0.3 * blur))
    colour = (room.wall + door * (room.doors[2] - room.wall)) * skirting
    sill = 0.3 + room.windows[2]
    pane = _within(_nearest(x + 0.7, room.windows[0]), room.windows[1] / 2, blur)
    pane = pane * jax.nn.sigmoid((high - sill) / blur) * jax.nn.sigmoid((sill + 1.3 - high) / blur)
    colour = colour + jnp.where(side < 0, pane * room.windows[3], 0)
    opening = _within(across + to_end * side, room.far[0], blur) * jax.nn.sigmoid((2.1 - high) / blur)
    colour = jnp.where(to_end < to_side, 0.7 * room.wall + opening * room.far[1], colour)

    blur = soft(to_ceiling)
    lamp = _within(_nearest(along_m + ahead + to_ceiling * forward, room.lamps[0]), room.lamps[1] / 2, blur / climb)
    lamp = lamp * _within(across + to_ceiling * side - room.lamps[3], room.lamps[2] / 2, blur)
    above = 0.5 + lamp * room.lamps[4]
    share = jax.nn.sigmoid((high - room.ceiling_m) / soft(to_wall))
    return room.polish * fresnel * (colour + share * (above - colour))
