"""Where in an image the view of a places search lies: the floor under a camera, the floor of a quad, or all of it."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ebjax.geometry.camera import Camera, camera_over_floor
from ebjax.geometry.warp import Taps, grid_points, taps
from ebjax.views.floor_view import SUPERSAMPLE, view_taps
from ebjax.views.run_view import choose_floor, from_camera, from_quad


def camera_view(camera: Camera, metres_per_px: float) -> tuple[Taps, Bool[Array, "h w"]]:
    """The floor ahead of a camera, and which pixels of that view it sees.

    Raises:
      ValueError: it sees too little floor.
    """
    view = from_camera(camera, choose_floor(camera, metres_per_px))
    return view_taps(view, camera), view.seen


def quad_view(
    size: tuple[int, int], quad: Float[np.ndarray, "4 2"], margin: float, side_px: int
) -> tuple[Taps, Bool[Array, "h w"]]:
    """The square that four points of an image of (width, height) `size` span, as `views.run_view.from_quad`.

    Raises:
      ValueError: they span no convex patch.
    """
    # The quad alone fixes the view; only its place on the floor in metres, unused here, needs a camera.
    camera = camera_over_floor(500.0, 500.0, 0.0, 0.0, *size, 1.0, 0.5)
    view = from_quad(camera, quad, margin, (side_px, side_px))
    return view_taps(view, camera), view.seen


@functools.partial(jax.jit, static_argnums=(0, 1))
def whole_image(size: tuple[int, int], view_size: tuple[int, int]) -> Taps:
    """An image of (width, height) `size`, resized to (height, width) `view_size`."""
    fine = SUPERSAMPLE * view_size[0], SUPERSAMPLE * view_size[1]
    sx, sy = size[0] / fine[1], size[1] / fine[0]
    # Outermost samples lie half a sample inside the image's border, where a bilinear read would fade to black.
    scaled = jnp.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1]], jnp.float32)
    return taps(grid_points(scaled, fine), size[::-1])
