"""Where pixels of the raw image lie on the floor under a camera, and how far their own uncertainty reaches there.

Differentiable in all of the camera, the lens by the derivative of the implicit function: a match, once found, is two
raw pixels, whatever is then believed of mount, focal length and lens.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ebjax.geometry.camera import OUTSIDE_PX, Camera, ideal_from_raw, raw_from_ideal, raw_slopes
from ebjax.geometry.homography import Arrays
from ebjax.geometry.homography import apply as apply_homography
from ebjax.geometry.homography import slopes as homography_slopes
from ebjax.geometry.mount import Mount, base_from_mounted_camera
from ebjax.geometry.warp import grid_points
from ebjax.train.calibrate_camera import MOUNT, Numbers, with_numbers
from ebjax.views.run_view import RunView, choose_floor, from_camera

LEAST_DOWN = 1e-3
"""Rays flatter than this, m of height per m ahead, are taken to meet the floor at that slope."""


class Rays(NamedTuple):
    """X / Z in the camera's frame, how it changes with the two errors of its pixel, and which pixels have a ray."""

    rays: Float[Array, "*n 3"]
    spreads: Float[Array, "*n 3 2"]
    there: Bool[Array, "*n"]


@jax.jit
def raw_keypoints(
    view: RunView, camera: Camera, keypoints: Float[Arrays, "N 2"], sigma_px: float | Float[Array, ""]
) -> tuple[Float[Array, "N 2"], Float[Array, "N 2 2"]]:
    """Raw pixels of keypoints of a floor view, and how they change with one standard deviation along its axes."""
    h = jnp.asarray(view.image_from_view)
    ideal = apply_homography(h, keypoints)
    slopes = jnp.einsum("nab,nbc->nac", raw_slopes(camera, ideal), homography_slopes(h, keypoints))
    return raw_from_ideal(camera, ideal), sigma_px * slopes


@jax.jit
def rays_of_pixels(camera: Camera, pixels: Float[Arrays, "*n 2"], slopes: Float[Arrays, "*n 2 2"]) -> Rays:
    """Rays of raw pixels, their errors' slopes with them."""
    shape = pixels.shape[:-1]
    flat = ideal_from_raw(camera, pixels.reshape(-1, 2))
    there = flat[:, 0] > OUTSIDE_PX
    k = jnp.asarray(camera.intrinsics)
    ideal = jnp.where(there[:, None], flat, k[:2, 2][None, :])
    (a, b), (c, d) = raw_slopes(camera, ideal).transpose(1, 2, 0)
    inverse = jnp.stack([jnp.stack([d, -b], -1), jnp.stack([-c, a], -1)], -2) / (a * d - b * c)[:, None, None]
    from_pixel = jnp.linalg.inv(k)
    rays = jnp.concatenate([ideal, jnp.ones_like(ideal[:, :1])], 1) @ from_pixel.T
    spreads = jnp.einsum("ab,nbc,ncd->nad", from_pixel[:, :2], inverse, slopes.reshape(-1, 2, 2))
    return Rays(rays.reshape(*shape, 3), spreads.reshape(*shape, 3, 2), there.reshape(shape))


@jax.jit
def on_floor(
    mount: Mount, rays: Float[Arrays, "*n 3"], spreads: Float[Arrays, "*n 3 2"]
) -> tuple[Float[Array, "*n 2"], Float[Array, "*n 2 2"]]:
    """Where rays meet the floor in base, m, and their pixels' standard deviations there."""
    pose = base_from_mounted_camera(mount)
    ray, spread = rays @ pose[:3, :3].T, jnp.einsum("ab,...bk->...ak", pose[:3, :3], spreads)
    down = jnp.minimum(ray[..., 2:], -LEAST_DOWN)
    reach = -pose[2, 3] / down
    points = reach * ray[..., :2] + pose[:2, 3].reshape(*(1,) * (rays.ndim - 1), 2)
    slopes = reach[..., None] * (spread[..., :2, :] - (ray[..., :2] / down)[..., None] * spread[..., 2:, :])
    return points, slopes


def floor_distance_m(a: Numbers, b: Numbers, camera: Camera, metres_per_px: float) -> float:
    """Mean distance of the floor points that two cameras give the pixels of a third one's floor view, m.

    Args:
      a: numbers of the first.
      b: of the second.
      camera: whose floor view is taken; of the same kind of lens as both.
      metres_per_px: of that view.
    """
    view = from_camera(camera, choose_floor(camera, metres_per_px))
    return float(_distance_m(a, b, camera, view.image_from_view, view.seen))


@jax.jit
def _distance_m(
    a: Numbers, b: Numbers, camera: Camera, image_from_view: Float[Arrays, "3 3"], seen: Bool[Arrays, "h w"]
) -> Float[Array, ""]:
    ideal = grid_points(jnp.asarray(image_from_view), seen.shape).reshape(-1, 2)
    pixels = raw_from_ideal(camera, ideal)
    none = jnp.zeros((*pixels.shape, 2), pixels.dtype)

    def points(numbers):
        rays = rays_of_pixels(with_numbers(camera, numbers), pixels, none)
        return on_floor(numbers[MOUNT], rays.rays, rays.spreads)[0], rays.there

    (first, there_a), (second, there_b) = points(a), points(b)
    shown = jnp.asarray(seen).reshape(-1) & there_a & there_b
    return jnp.where(shown, jnp.linalg.norm(first - second, axis=1), 0).sum() / shown.sum()
