"""The rays that a lens bends: one a raw pixel, and how they turn from one pixel to the next.

A pinhole's rays have depth 1 along the optical axis. So have these, up to 87 degrees from it; beyond, where no image
has depth, their length is 20.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ebjax.geometry.camera import LEAST_COSINE, Camera, rays_of
from ebjax.geometry.pytree import pytree


@pytree
class Rays:
    """Rays in the camera's frame."""

    directions: Float[Array, "3 H W"]
    steps: Float[Array, "2 3 H W"]
    """d(direction)/d(pixel u) and d(direction)/d(pixel v): how large a pixel's footprint is."""
    shown: Bool[Array, "H W"]
    """Pixels in the lens's domain; the others stay black."""
    ahead: Bool[Array, "H W"]
    """Shown pixels at less than 87 degrees from the optical axis; the others have no depth."""


@jax.jit
def bent_rays(camera: Camera) -> Rays:
    """Casts a camera's pixels through its lens, in float64 where JAX has it; the result is of the camera's dtype.

    Differentiable in the lens and the intrinsics, but for the steps.
    """
    axes = (jnp.arange(side, dtype=jnp.result_type(float)) for side in (camera.width, camera.height))
    u, v = jnp.meshgrid(*axes)
    pixels = jnp.stack([u.reshape(-1), v.reshape(-1)], axis=1)

    def cast(pixels: Float[Array, "N 2"]):
        rays, shown = rays_of(camera, pixels)
        rays = jnp.where(shown[:, None], rays, jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0], rays.dtype), rays.shape))
        return rays / jnp.maximum(rays[:, 2:], LEAST_COSINE), (shown, shown & (rays[:, 2] >= LEAST_COSINE))

    def along(step: Float[Array, "2"]):
        return jax.jvp(cast, (pixels,), (jnp.broadcast_to(step, pixels.shape),), has_aux=True)

    directions, steps, (shown, ahead) = jax.vmap(along, out_axes=(None, 0, None))(jnp.eye(2, dtype=pixels.dtype))
    dtype, size = jnp.asarray(camera.intrinsics).dtype, camera.size
    return Rays(
        directions.T.reshape(3, *size).astype(dtype),
        jax.lax.stop_gradient(steps).swapaxes(1, 2).reshape(2, 3, *size).astype(dtype),
        shown.reshape(size),
        ahead.reshape(size),
    )
