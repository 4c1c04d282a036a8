"""Two looks at the same floor from opposite sides, as a robot would get them: what floornet learns from.

Both are kept in the orientation of the first (the network is equivariant, R_pi adds nothing): the second is the floor
as seen by a robot that faces the other way, in its own light, with its far side where the first one has its near side.
All views of a floor are taken in one room, which a polished floor mirrors (`mirror`), and of one contrast.
"""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key

from ebjax.geometry.pytree import pytree
from ebjax.geometry.warp import sample_bilinear
from ebjax.train.mirror import Room, draw_room, mirrored
from ebjax.train.photograph import PATCH_SHARE, TAME, Wild, around, patched, photograph, uniform
from ebjax.train.processes import map_rows

PITCH_PX = 166
"""Distance of places on a canvas: nine, which hardly overlap."""
ZOOM = (0.8, 1.15)
OWN_TURN_DEG, OWN_TILT = 3.0, 0.03
TURN_DEG, SCALE, SHIFT, TILT = 8.0, 0.14, 0.18, 0.06
"""Of the second view against the first: degrees, shares of scale and side, change of scale across the view."""
ELEVATION = (0.3, 0.9)
"""Horizontal part of the direction from which a pile is seen."""
PIXEL_M = 0.01
FOOT_M, HEIGHT_M = (0.2, 0.9), (0.25, 1.3)
"""From the camera's foot to the near edge; of the camera."""
ALIKE = 0.5
"""Share of floors of which all places are seen with the same mirror image."""
PALE = 0.4
"""Share of floors whose pattern is fainter than it was painted, down to CONTRAST."""
CONTRAST = 0.15


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Pairs:
    """N places: two views of each, the field of view of each side, and where pixels of the first lie in the second."""

    first: Float[Array, "N S S"]
    second: Float[Array, "N S S"]
    seen_first: Float[Array, "S S"]
    seen_second: Float[Array, "S S"]
    second_from_first: Float[Array, "N 3 3"]


def _homography(
    centre: Float[Array, "2"],
    zoom: Float[Array, ""],
    turn_deg: Float[Array, ""],
    tilt: Float[Array, "2"],
    side: int,
) -> Float[Array, "3 3"]:
    """Canvas pixels from view pixels: about the view's centre, which lies at `centre`."""
    angle, middle = jnp.radians(turn_deg), (side - 1) / 2
    c, s = jnp.cos(angle) * zoom, jnp.sin(angle) * zoom
    one, zero = jnp.float32(1), jnp.float32(0)
    moved = jnp.array([[c, -s, centre[0]], [s, c, centre[1]], [zero, zero, one]])
    tilted = jnp.array([[one, zero, zero], [zero, one, zero], [tilt[0] / side, tilt[1] / side, one]])
    return moved @ tilted @ jnp.array([[1, 0, -middle], [0, 1, -middle], [0, 0, 1]], jnp.float32)


def _trapezoid(side: int, *, key: Key[Array, ""]) -> Float[Array, "S S"]:
    """What a camera sees of the square before it: at the near edge (the last row) less than at the far one."""
    near_key, reach_key = jax.random.split(key)
    near, reach = uniform(near_key, (0.15, 0.5)), uniform(reach_key, (0.05, 0.8))
    ticks = (jnp.arange(side, dtype=jnp.float32) + 0.5) / side
    half = near + (0.51 - near) * jnp.minimum((1 - ticks) / reach, 1)
    return (jnp.abs(ticks - 0.5)[None, :] <= half[:, None]).astype(jnp.float32)


@pytree
class Floor:
    """What all views of a canvas share."""

    room: Room
    contrast: Float[Array, ""]
    mount: Float[Array, "2"]
    """Of the camera, each in [0, 1]: its foot and its height."""
    stands: Float[Array, "2 3"]
    """Where robots stand in the room, there and back, each in [0, 1]: aside, heading, along."""
    alike: Bool[Array, ""]
    """They stand so at every place, as where lamps and windows repeat: the mirror image tells no places apart."""


def _draw_floor(wild: Wild, *, key: Key[Array, ""]) -> Floor:
    room_key, share_key, contrast_key, stand_key = jax.random.split(key, 4)
    pale = uniform(share_key, (0.0, 1.0)) < wild.rest * PALE
    faint = jnp.exp(uniform(contrast_key, (float(np.log(CONTRAST)), 0.0)))
    draw = jax.random.uniform(stand_key, (9,), jnp.float32)
    room = draw_room(wild.mirrors, key=room_key)
    return Floor(room, jnp.where(pale, faint, 1), draw[:2], draw[2:8].reshape(2, 3), draw[8] < ALIKE)


def _reflection(floor: Floor, side: int, way: int, *, key: Key[Array, ""]) -> Float[Array, "S S"]:
    """What the floor mirrors on the way there (0) or back (1), its near edge in the last row."""
    own = jax.random.uniform(key, (3,), jnp.float32)
    aside, heading, along = jnp.where(floor.alike, floor.stands[way] + 0.04 * (own - 0.5), own)
    foot, height = floor.mount
    ticks = (jnp.arange(side, dtype=jnp.float32) + 0.5) * PIXEL_M
    ahead = FOOT_M[0] + (FOOT_M[1] - FOOT_M[0]) * foot + ticks[::-1]
    right = ticks - side * PIXEL_M / 2 + 0.6 * (aside - 0.5)
    x, y = jnp.meshgrid(right, ahead)
    height_m = HEIGHT_M[0] + (HEIGHT_M[1] - HEIGHT_M[0]) * height
    return mirrored(floor.room, (x, y), height_m, 0.5 * (heading - 0.5), 12 * along)


def _pair(canvas, centre, zoom, side, floor, wild, *, key):
    keys = iter(jax.random.split(key, 12))
    wild_keys = iter(jax.random.split(jax.random.fold_in(key, 1), 4))
    first = _homography(centre, zoom, around(next(keys), OWN_TURN_DEG), around(next(keys), OWN_TILT, (2,)), side)
    moved = centre + zoom * side * around(next(keys), SHIFT, (2,))
    scale = zoom * (1 + around(next(keys), SCALE))
    second = _homography(moved, scale, around(next(keys), TURN_DEG), around(next(keys), TILT, (2,)), side)
    ticks = jnp.arange(side, dtype=jnp.float32)
    pixels = jnp.stack([*jnp.meshgrid(ticks, ticks), jnp.ones((side, side), jnp.float32)], -1).reshape(-1, 3)
    nearness = (ticks + 0.5) / side

    def seen(homography, sign):
        at = pixels @ homography.T
        at = jnp.clip(at[:, :2] / at[:, 2:], 0, canvas.shape[0] - 1.0)
        found = sample_bilinear(canvas, at).reshape(side, side, 3)
        elevation = uniform(next(keys), ELEVATION)
        linear = found[..., 0] - sign * elevation * found[..., 2]
        linear = jnp.maximum(linear + (floor.contrast - 1) * (linear - linear.mean()), 0.005)
        linear = patched(linear, wild.rest * PATCH_SHARE, key=next(wild_keys))
        reflection = _reflection(floor, side, (1 - sign) // 2, key=next(wild_keys))[::sign, ::sign]
        return photograph(linear, nearness[::sign], reflection, wild, key=next(keys))

    return seen(first, 1), seen(second, -1), jnp.linalg.inv(second) @ first


@partial(jax.jit, static_argnames=("places", "side", "wild"))
def sample_pairs(
    canvases: Float[Array, "C h w 3"], places: int, side: int, wild: Wild = TAME, *, key: Key[Array, ""]
) -> Pairs:
    """Views of `side` px of random places on each canvas, canvas by canvas.

    Args:
      canvases: from `make_canvas`; a view's pixel is about one of theirs.
      places: of each canvas, at most 9.
      side: of the views.
      wild: how often they are as real floors are.
      key: of everything random.
    """
    field_key, key = jax.random.split(key)
    field = _trapezoid(side, key=field_key)
    middle = (canvases.shape[1] - 1) / 2
    grid = jnp.stack(jnp.meshgrid(*(jnp.arange(-1, 2, dtype=jnp.float32),) * 2), -1).reshape(-1, 2) * PITCH_PX + middle

    def of_canvas(args):
        canvas, key = args
        order_key, zoom_key, pair_key = jax.random.split(key, 3)
        centres = jax.random.permutation(order_key, grid)[:places]
        zoom = uniform(zoom_key, ZOOM)
        keys = jax.random.split(pair_key, places)
        floor = _draw_floor(wild, key=jax.random.fold_in(key, 1))
        return jax.lax.map(
            lambda one: _pair(canvas.astype(jnp.float32), one[0], zoom, side, floor, wild, key=one[1]), (centres, keys)
        )

    made = map_rows(of_canvas, (canvases, jax.random.split(key, len(canvases))))
    first, second, warp = (leaf.reshape(-1, *leaf.shape[2:]) for leaf in made)
    return Pairs(first, second, field, field[::-1, ::-1], warp)
