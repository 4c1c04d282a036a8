"""Casts one ray a pixel on a plan's planes, boxes and posts: linear radiance and depth of what a camera sees.

Texture is filtered by footprint, the edges of doors and skirting by box coverage: one ray a pixel does not alias.
Differentiable in the camera, the pose, the light and the floor's texels; `vmap` over poses renders a batch.
"""

import dataclasses
import typing

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ebjax.floors import atlas
from ebjax.floors.lattice import entry
from ebjax.floors.obstacles import Boxes, Posts, see_boxes, see_posts, shade_by_boxes, shade_by_posts
from ebjax.floors.ramp import Ramp, see_level
from ebjax.floors.rays import Rays, bent_rays
from ebjax.floors.scene import (
    CEILING_M,
    LAMP_SPACING_M,
    Scene,
    ceiling,
    covered,
    lamps,
    nearest_wall,
    wall_colour,
    window_panes,
)
from ebjax.geometry.camera import Camera
from ebjax.geometry.pytree import pytree

LAMP_RADIANCE = 3.0
DAYLIGHT_M = 60.0
SUN_SPACING_M, SUN_WIDTH_M, SUN_SLANT = 3.1, 0.9, 0.6
Component = Float[Array, "H W"]
Step = list[Component] | Float[Array, "3 *rows"]
Things = typing.TypeVar("Things", Boxes, Posts)


@pytree
class Mirror:
    """What a polished floor mirrors besides its lamps; leading axes as those of Light."""

    strength: Float[Array, "*lights"]
    """0 to 1, of walls, doors and ceiling."""
    windows: Float[Array, "*lights"]
    """Radiance of windows in the walls, one between two doors: they are seen in the walls too."""
    rough: Float[Array, "*lights"]
    """Softness of the image a metre of way from the floor."""


@pytree
class Light:
    """What differs between two traverses of the same corridor; leading axes stack several lights."""

    level: Float[Array, "*lights 3"]
    """Radiance of a white floor, per channel."""
    contrast: Float[Array, "*lights"]
    """Depth of the pools of light under the lamps, 0 to 1."""
    slope: Float[Array, "*lights 2"]
    """Relative growth of the light along x and y, 1/m: daylight from one end, even beyond `DAYLIGHT_M`."""
    gloss: Float[Array, "*lights"]
    """Strength of the mirror image of lamps and windows in the floor, 0 to 1."""
    sun: Float[Array, "*lights K"]
    """What the sun adds on the floor behind windows, times the lamps' light; 0 is no window; K is a power of two."""
    sun_shift: Float[Array, "*lights"]
    """Where along the corridors it does, m."""
    mirror: Mirror | None = None
    """None: of the room the floor mirrors the lamps alone."""


@pytree
class Passers:
    """What moves from frame to frame; heights are above the floor."""

    boxes: Boxes
    posts: Posts


def _footprint(
    t: Component, ray: list[Component], steps: list[Step], normal: list, normal_ray: Component
) -> list[list[Component]]:
    """d(hit)/d(pixel u, v) along the world axes, m: t (step - ray (n . step) / (n . ray))."""
    slants = [sum(n * s for n, s in zip(normal, step, strict=True)) / normal_ray for step in steps]
    return [[t * (step[i] - slant * ray[i]) for i in range(3)] for step, slant in zip(steps, slants, strict=True)]


def _walls(
    scene: Scene,
    ray: list[Component],
    steps: list[Step],
    origin: Float[Array, "3 *rows"],
    t_level: Component,
    mirror: Mirror | None,
) -> tuple[Float[Array, "H W 3"], Component]:
    """Reflectance of the nearest wall along every ray, and its depth; beyond the floor the ray goes up again."""
    hit = nearest_wall(scene.walls, ray, origin)
    ex, ey = hit.direction[..., 0], hit.direction[..., 1]
    by_u, by_v = _footprint(hit.t, ray, steps, [-ey, ex, 0.0], hit.normal_ray)
    wide = jnp.abs(ex * by_u[0] + ey * by_u[1]) + jnp.abs(ex * by_v[0] + ey * by_v[1]) + 1e-6
    tall = jnp.abs(by_u[2]) + jnp.abs(by_v[2]) + 1e-6
    doors, plaster = scene.doors[hit.wall], scene.wall_colours[hit.wall]
    height = origin[2] + hit.t * ray[2]
    if scene.ramp is not None:
        height = height - scene.ramp.height(origin[0] + hit.t * ray[0], origin[1] + hit.t * ray[1])
    if mirror is not None:
        softer = mirror.rough * jnp.maximum(hit.t - t_level, 0)
        wide, tall, height = wide + softer, tall + softer, jnp.abs(height)
    colour = wall_colour(plaster, hit.along, height, wide, tall, hit.length, doors[..., 0], doors[..., 1])
    colour = colour * (0.85 + 0.15 * jnp.abs(ex))[..., None]
    if mirror is not None:
        panes = window_panes(hit.along, height, wide, tall, hit.length, doors[..., 0], doors[..., 1])
        colour = colour + (mirror.windows * panes)[..., None]
    return colour, hit.t


def _fresnel(step: list[Component], up: Component) -> Component:
    """Share of the light that a level floor mirrors (Schlick 1994): it grows with distance."""
    cosine = up / jnp.sqrt(step[0] ** 2 + step[1] ** 2 + up**2)
    return 0.04 + 0.96 * (1 - cosine) ** 5


def _mirrored_lamps(
    along: Component, across: Component, step: list[Component], up: Component, size: Float[Array, "3"] | None
) -> Component:
    """What the glossy floor mirrors of the lamps."""
    climb = CEILING_M / up
    image = lamps(along + climb * step[0], across + climb * step[1], 0.03 + 0.02 * climb, size)
    return LAMP_RADIANCE * _fresnel(step, up) * image


def _mirrored_room(
    mirror: Mirror,
    walls: tuple[Float[Array, "H W 3"], Component],
    ground: atlas.Ground,
    step: list[Component],
    t: Component,
    up: Component,
) -> Float[Array, "H W 3"]:
    """What the floor mirrors of walls and ceiling: the ceiling is met CEILING_M / up after the floor."""
    climb = CEILING_M / up
    panels = ceiling(ground.along + climb * step[0], ground.across + climb * step[1], 0.02 + mirror.rough * climb, 0.0)
    colour, t_wall = walls
    seen = jnp.where((t_wall < t + climb)[..., None], colour, panels)
    return (mirror.strength * _fresnel(step, up))[..., None] * seen


def _by_row(vector: Float[Array, "*H 3"]) -> Float[Array, "3 *rows"]:
    """A vector, or one a row of the image, as components that spread over the image."""
    return vector if vector.ndim == 1 else vector.T[..., None]


def _pinhole_rays(camera: Camera, rotation: Float[Array, "*H 3 3"]) -> tuple[list[Component], list[Step]]:
    """Rays of depth 1 in the world, and how they change with the pixel's u and v."""
    inverse = jnp.linalg.inv(camera.intrinsics)
    u, v = jnp.meshgrid(*(jnp.arange(side, dtype=rotation.dtype) for side in (camera.width, camera.height)))
    by_u, by_v, first = (_by_row(rotation @ inverse[:, k]) for k in range(3))
    return [u * by_u[i] + v * by_v[i] + first[i] for i in range(3)], [by_u, by_v]


def _turned(rotation: Float[Array, "*H 3 3"], vectors: Float[Array, "3 H W"]) -> list[Component]:
    """Vectors of the camera's frame in the world."""
    columns = [_by_row(rotation[..., k]) for k in range(3)]
    return [sum((vectors[k] * columns[k][i] for k in (1, 2)), vectors[0] * columns[0][i]) for i in range(3)]


def _raised(things: Things, ramp: Ramp | None) -> Things:
    """Boxes or posts whose heights are above the floor, in the world."""
    if ramp is None:
        return things
    height = ramp.height(things.centres[:, 0], things.centres[:, 1])
    return dataclasses.replace(things, bottoms=things.bottoms + height, tops=things.tops + height)


def _sun(along: Component, across: Component, footprint: Component, light: Light) -> Component:
    """What the sun adds: slanted patches through windows with a bar in the middle."""
    x = along + SUN_SLANT * across - light.sun_shift
    window = jnp.round(jax.lax.stop_gradient(x) / SUN_SPACING_M)
    x = x - SUN_SPACING_M * window
    blur = footprint + 0.02
    pane = covered(jnp.abs(x), 0.03, SUN_WIDTH_M / 2, blur)
    number, windows = window.astype(jnp.int32), light.sun.shape[-1]
    strength = light.sun[entry(number, jnp.zeros_like(number), (windows, 1), windows)]
    return strength * pane * covered(across, -0.75, 0.35, blur)


def render(
    scene: Scene,
    camera: Camera,
    world_from_base: Float[Array, "*H 4 4"],
    light: Light,
    passers: Passers,
    rays: Rays | None = None,
) -> tuple[Float[Array, "H W 3"], Float[Array, "H W"]]:
    """Radiance of every raw pixel and the depth of what it sees, world point = t + depth R K^-1 (x, y, 1).

    (x, y) are the ideal pixel's: behind a lens `ideal_from_raw` leads to them.

    Args:
      scene: walls, doors, floor, furniture.
      camera: its pose is relative to the base.
      world_from_base: the robot, or where it is at each row of the image; its camera must lie within the walls.
      light: of this traverse.
      passers: people and carts, where they are now; heights are above the floor.
      rays: `bent_rays` of the camera, which many frames share; a pinhole needs none.

    Returns:
      Linear RGB, and the distance along the optical axis in metres: infinite where no surface is hit, 0 where the lens
      shows nothing, which is black, or looks 87 degrees and more aside.
    """
    pose = world_from_base @ camera.base_from_camera
    rotation, origin = pose[..., :3, :3], _by_row(pose[..., :3, 3])
    steps: list[Step]
    if rays is None and camera.lens.model != "pinhole":
        rays = bent_rays(camera)
    if rays is None:
        ray, steps = _pinhole_rays(camera, rotation)
    else:
        ray, steps = _turned(rotation, rays.directions), [_turned(rotation, step) for step in rays.steps]

    t_level, down, rise, normal = see_level(scene.ramp, ray, origin, CEILING_M)
    plaster, t_wall = _walls(scene, ray, steps, origin, t_level, light.mirror)
    is_level = t_level <= t_wall
    is_floor: Bool[Array, "H W"] = is_level & down

    # Rays that miss floor and ceiling are given a harmless one, so that no gradient is NaN.
    t, up = jnp.where(is_level, t_level, 1.0), jnp.where(is_level, jnp.abs(rise), 1.0)
    x, y = origin[0] + t * ray[0], origin[1] + t * ray[1]
    ground = atlas.locate(scene.floor, x, y)
    by_u, by_v = _footprint(t, ray, steps, normal, jnp.where(down, -up, up))
    by_pixel = jnp.stack([jnp.stack(by_u[:2], axis=-1), jnp.stack(by_v[:2], axis=-1)], axis=-2)
    c, s = ground.direction[..., 0], ground.direction[..., 1]
    step = [c * ray[0] + s * ray[1], c * ray[1] - s * ray[0]]
    size = (jnp.abs(by_u[0]) + jnp.abs(by_u[1]) + jnp.abs(by_v[0]) + jnp.abs(by_v[1])) / 2

    floor = atlas.look(scene.floor, ground, by_pixel)
    if floor.shape[-1] == 5:
        length = jnp.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
        floor = floor[..., :3] * (1 + (floor[..., 3] * ray[0] + floor[..., 4] * ray[1]) / length)[..., None]
    shade = (1 - 0.3 * jnp.exp(-ground.clearance / 0.12)) * shade_by_posts(passers.posts, x, y)
    shade = shade * shade_by_boxes(scene.furniture, x, y) * shade_by_boxes(passers.boxes, x, y)
    floor = floor * shade[..., None]
    floor = floor * (1 + _sun(ground.along, ground.across, size, light))[..., None]
    above = ceiling(ground.along, ground.across, size, LAMP_RADIANCE, scene.lamp_m)
    colour = jnp.where(is_level[..., None], jnp.where(down[..., None], floor, above), plaster)

    depth = jnp.where(is_level, t_level, t_wall)
    hit_x, hit_y = (origin[i] + jnp.where(jnp.isfinite(depth), depth, 0.0) * ray[i] for i in (0, 1))
    wave = 2 * jnp.pi / LAMP_SPACING_M
    pools = 1 + light.contrast * (0.7 * jnp.cos(wave * hit_x) + 0.3 * jnp.cos(wave * hit_y))
    far_x, far_y = (jnp.clip(hit, -DAYLIGHT_M, DAYLIGHT_M) for hit in (hit_x, hit_y))
    colour = colour * (pools * jnp.maximum(1 + light.slope[0] * far_x + light.slope[1] * far_y, 0.1))[..., None]
    glare = light.gloss * _mirrored_lamps(ground.along, ground.across, step, up, scene.lamp_m)
    colour = colour + jnp.where(is_floor, glare, 0.0)[..., None]
    if light.mirror is not None:
        room = _mirrored_room(light.mirror, (plaster, t_wall), ground, step, t, up)
        colour = colour + jnp.where(is_floor[..., None], room, 0.0)
    for boxes in (scene.furniture, passers.boxes):
        depth, colour = see_boxes(_raised(boxes, scene.ramp), ray, origin, depth, colour)
    depth, colour = see_posts(_raised(passers.posts, scene.ramp), ray, origin, depth, colour)
    if rays is not None:
        depth, colour = jnp.where(rays.ahead, depth, 0.0), jnp.where(rays.shown[..., None], colour, 0.0)
    return colour * light.level[None, None, :], depth
