"""The floor from above: samples of the view in the image, the view itself, and what of it is clear floor."""

from functools import partial

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, UInt8

from ebjax.geometry.camera import Camera, backproject, raw_from_ideal
from ebjax.geometry.homography import apply
from ebjax.geometry.warp import Taps, gather, grid_points, taps
from ebjax.views.run_view import RunView

SUPERSAMPLE = 2
"""Each view pixel averages so many samples a side: near floor is imaged finer than the view and would alias."""
OBSTACLE_M = (0.05, 0.02)
"""What rises above the floor by more than this, plus this share of its distance, is no floor: a wall, a leg."""


def clear_floor(depth_m: Float[Array, "H W"], view: RunView, camera: Camera) -> Bool[Array, "h w"]:
    """View pixels where depth shows floor or nothing at all; robust to a T_base_camera that is some degrees off."""
    height, width = view.size
    rows, columns = jnp.meshgrid(jnp.arange(height), jnp.arange(width), indexing="ij")
    grid = jnp.stack([columns.reshape(-1), rows.reshape(-1)], -1).astype(view.image_from_view.dtype)
    pixels = apply(view.image_from_view, grid)
    nearest = jnp.round(raw_from_ideal(camera, pixels)).astype(jnp.int32)
    u, v = jnp.clip(nearest[:, 0], 0, camera.width - 1), jnp.clip(nearest[:, 1], 0, camera.height - 1)
    depth = depth_m[v, u]
    points = backproject(pixels, depth, camera.intrinsics)
    pose = jnp.asarray(camera.base_from_camera)
    up = points @ pose[2, :3] + pose[2, 3]
    standing = (depth > 0) & (up > OBSTACLE_M[0] + OBSTACLE_M[1] * depth)
    return view.seen & ~standing.reshape(height, width)


@partial(jax.jit, static_argnames="dtype")
def view_taps(view: RunView, camera: Camera, dtype: DTypeLike = jnp.float32) -> Taps:
    """The samples of the supersampled view in the image, once for the run; differentiable in the view."""
    height, width = view.size
    fine = (SUPERSAMPLE * height, SUPERSAMPLE * width)
    offset = (1 - SUPERSAMPLE) / (2 * SUPERSAMPLE)
    view_from_fine = jnp.array([[1 / SUPERSAMPLE, 0, offset], [0, 1 / SUPERSAMPLE, offset], [0, 0, 1]])
    image_from_fine = view.image_from_view @ view_from_fine.astype(view.image_from_view.dtype)
    points = raw_from_ideal(camera, grid_points(image_from_fine.astype(dtype), fine).reshape(-1, 2))
    found = taps(points.reshape(*fine, 2), camera.size)
    return Taps(found.indices, found.weights.astype(dtype))


def floor_view(rgb: UInt8[Array, "H W C"] | Float[Array, "H W C"], samples: Taps) -> Float[Array, "h w C"]:
    """The floor from above, in [0, 1], averaged down from the supersampled warp."""
    # Without the barrier XLA gathers anew for every slice; a mean over reshaped axes is as slow.
    fine = jax.lax.optimization_barrier(gather(rgb, samples))
    rows, columns = range(SUPERSAMPLE), range(SUPERSAMPLE)
    return sum(fine[r::SUPERSAMPLE, c::SUPERSAMPLE] for r in rows for c in columns) / SUPERSAMPLE**2
