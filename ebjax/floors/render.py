"""Casts one ray a pixel on the planes of a corridor: linear radiance and depth of what a pinhole camera sees.

Texture is filtered by footprint, the edges of doors and skirting by box coverage: one ray a pixel does not alias.
Differentiable in the camera, the pose, the light and the floor's texels.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ebjax.floors import mipmap
from ebjax.floors.corridor import (
    CEILING,
    CEILING_M,
    LAMP_SPACING_M,
    Corridor,
    corner_shade,
    lamps,
    nearest_wall,
    wall_colour,
)
from ebjax.geometry.camera import Camera

LAMP_RADIANCE = 3.0
Component = Float[Array, "H W"]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Light:
    """What differs between two traverses of the same corridor; leading axes stack several lights."""

    level: Float[Array, "*lights 3"]
    """Radiance of a white floor, per channel."""
    contrast: Float[Array, "*lights"]
    """Depth of the pools of light under the lamps, 0 to 1."""
    slope: Float[Array, "*lights"]
    """Relative growth of the light along x, 1/m: daylight from one end."""
    gloss: Float[Array, "*lights"]
    """Strength of the lamps' mirror image in the floor, 0 to 1."""


def _footprint(
    t: Component, ray: list[Component], steps: list[Float[Array, "3"]], normal: list, normal_ray: Component
) -> list[list[Component]]:
    """d(hit)/d(pixel u, v) along the world axes, m: t (step - ray (n . step) / (n . ray))."""
    slants = [sum(n * s for n, s in zip(normal, step, strict=True)) / normal_ray for step in steps]
    return [[t * (step[i] - slant * ray[i]) for i in range(3)] for step, slant in zip(steps, slants, strict=True)]


def _walls(
    corridor: Corridor, ray: list[Component], steps: list[Float[Array, "3"]], origin: Float[Array, "3"]
) -> tuple[Float[Array, "H W 3"], Component]:
    """Reflectance of the nearest wall along every ray, and its depth."""
    hit = nearest_wall(corridor.walls, ray, origin)
    ex, ey = hit.direction[..., 0], hit.direction[..., 1]
    by_u, by_v = _footprint(hit.t, ray, steps, [-ey, ex, 0.0], hit.normal_ray)
    wide = jnp.abs(ex * by_u[0] + ey * by_u[1]) + jnp.abs(ex * by_v[0] + ey * by_v[1]) + 1e-6
    tall = jnp.abs(by_u[2]) + jnp.abs(by_v[2]) + 1e-6
    doors = corridor.doors[hit.wall]
    colour = wall_colour(hit.along, origin[2] + hit.t * ray[2], wide, tall, hit.length, doors[..., 0], doors[..., 1])
    return colour * (0.85 + 0.15 * jnp.abs(ex))[..., None], hit.t


def _mirrored_lamps(x: Component, y: Component, ray: list[Component], up: Component) -> Component:
    """What the glazed floor at (x, y) mirrors of the lamps; Fresnel (Schlick) makes it grow with distance."""
    climb = CEILING_M / up
    cosine = up / jnp.sqrt(ray[0] ** 2 + ray[1] ** 2 + up**2)
    fresnel = 0.04 + 0.96 * (1 - cosine) ** 5
    return LAMP_RADIANCE * fresnel * lamps(x + climb * ray[0], y + climb * ray[1], 0.03 + 0.02 * climb)


def render(
    corridor: Corridor, camera: Camera, world_from_base: Float[Array, "4 4"], light: Light
) -> tuple[Float[Array, "H W 3"], Float[Array, "H W"]]:
    """Radiance of every pixel and the depth of what it sees, world point = t + depth R K^-1 (x, y, 1).

    Args:
      corridor: walls, doors and floor.
      camera: its pose is relative to the base.
      world_from_base: the robot; its camera must lie within the walls.
      light: of this traverse.

    Returns:
      Linear RGB, and the distance along the optical axis in metres (infinite where no surface is hit).
    """
    pose = world_from_base @ camera.base_from_camera
    rotation, origin, inverse = pose[:3, :3], pose[:3, 3], jnp.linalg.inv(camera.intrinsics)
    u, v = jnp.meshgrid(jnp.arange(camera.width, dtype=pose.dtype), jnp.arange(camera.height, dtype=pose.dtype))
    steps = [rotation @ inverse[:, 0], rotation @ inverse[:, 1]]
    first = rotation @ inverse[:, 2]
    ray = [u * steps[0][i] + v * steps[1][i] + first[i] for i in range(3)]

    down = ray[2] < 0
    upright = jnp.where(jnp.abs(ray[2]) < 1e-9, 1e-9, ray[2])
    t_level = jnp.where(down, -origin[2], CEILING_M - origin[2]) / upright
    plaster, t_wall = _walls(corridor, ray, steps, origin)
    is_level = t_level <= t_wall
    is_floor: Bool[Array, "H W"] = is_level & down

    # Rays that miss the floor are given a harmless one, so that no gradient is NaN.
    t, up = jnp.where(is_floor, t_level, 1.0), jnp.where(is_floor, -ray[2], 1.0)
    x, y = origin[0] + t * ray[0], origin[1] + t * ray[1]
    by_pixel = jnp.stack([jnp.stack(d[:2], axis=-1) for d in _footprint(t, ray, steps, [0.0, 0.0, 1.0], -up)], axis=-2)
    texel = jnp.stack([x - corridor.floor_origin[0], y - corridor.floor_origin[1]], axis=-1) / corridor.texel_m - 0.5
    floor = mipmap.sample_anisotropic(corridor.floor, texel, by_pixel / corridor.texel_m)
    floor = floor * corner_shade(corridor.walls, x, y)[..., None]

    level = jnp.where(down[..., None], floor, jnp.array(CEILING, pose.dtype)[None, None, :])
    colour = jnp.where(is_level[..., None], level, plaster)
    depth = jnp.where(is_level, t_level, t_wall)
    hit_x = origin[0] + jnp.where(jnp.isfinite(depth), depth, 0.0) * ray[0]
    pools = 1 + light.contrast * jnp.cos(2 * jnp.pi * hit_x / LAMP_SPACING_M)
    shade = pools * jnp.maximum(1 + light.slope * hit_x, 0.1)
    glare = jnp.where(is_floor, light.gloss * _mirrored_lamps(x, y, ray, up), 0.0)
    return (colour * shade[..., None] + glare[..., None]) * light.level[None, None, :], depth
