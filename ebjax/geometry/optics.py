"""Changes of what a camera's intrinsics and lens say, differentiable: the counterpart of `mount.Mounting`."""

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Float

from ebjax.geometry.camera import Camera
from ebjax.geometry.lens import Lens
from ebjax.geometry.pytree import pytree


@pytree
class Optics:
    """What is added to a camera's fx, fy, cx, cy, px, and to the coefficients of its lens."""

    intrinsics: Float[Array, "4"]
    coefficients: Float[Array, " C"]


def unchanged(camera: Camera) -> Optics:
    """Adds nothing."""
    dtype = jnp.asarray(camera.intrinsics).dtype
    return Optics(jnp.zeros(4, dtype), jnp.zeros(len(camera.lens.coefficients), dtype))


def with_optics(camera: Camera, optics: Optics) -> Camera:
    """The camera behind a changed lens of the same model; differentiable in the optics."""
    k = jnp.asarray(camera.intrinsics)
    fx, fy, cx, cy = jnp.asarray(optics.intrinsics, k.dtype)
    coefficients = jnp.asarray(camera.lens.coefficients, k.dtype) + jnp.asarray(optics.coefficients, k.dtype)
    k = k.at[0, 0].add(fx).at[1, 1].add(fy).at[0, 2].add(cx).at[1, 2].add(cy)
    return dataclasses.replace(camera, intrinsics=k, lens=Lens(coefficients, camera.lens.model))
