"""A camera in the numbers that calibration tunes, and how well they are known beforehand.

The numbers are pitch, roll, yaw (rad), height, x, y (m) of `mount_numbers`; fx, cx, cy (px), fy keeping its ratio to
fx; and the coefficients of the lens.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ebjax.geometry.camera import Camera, rays_of
from ebjax.geometry.homography import Arrays
from ebjax.geometry.lens import Lens, bend
from ebjax.geometry.mount import base_from_mounted_camera
from ebjax.geometry.mount_numbers import NAMES as MOUNT_NAMES
from ebjax.geometry.mount_numbers import mount_of

MOUNT = slice(0, 6)
INTRINSICS = slice(6, 9)
COEFFICIENTS = slice(9, None)
BROWN = "k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tau_x tau_y".split()
COEFFICIENT_NAMES = {
    "pinhole": [],
    "plumb_bob": BROWN,
    "rational_polynomial": BROWN,
    "equidistant": "k1 k2 k3 k4".split(),
    "omnidirectional": "xi k1 k2 p1 p2".split(),
}
STRAIGHT = Lens(np.zeros(5), "plumb_bob")
"""Where the search for an unknown lens starts."""
GRID = 17
"""Points along either side of the image, at which a lens is asked what it shows, and how far a coefficient moves it."""

Numbers = Float[Arrays, " N"]


def names(camera: Camera) -> tuple[str, ...]:
    """Of a camera's numbers, in their order."""
    lens = COEFFICIENT_NAMES[camera.lens.model][: len(camera.lens.coefficients)]
    return (*MOUNT_NAMES, "fx", "cx", "cy", *lens)


def numbers_of(camera: Camera) -> Float[np.ndarray, " N"]:
    """The numbers of a camera; `with_numbers` is the inverse."""
    k = np.asarray(camera.intrinsics, np.float64)
    mount = mount_of(np.asarray(camera.base_from_camera, np.float64))
    return np.concatenate([mount, [k[0, 0], k[0, 2], k[1, 2]], np.asarray(camera.lens.coefficients, np.float64)])


@jax.jit
def with_numbers(camera: Camera, numbers: Numbers) -> Camera:
    """A camera of the same image size, ratio of fy to fx and kind of lens, with these numbers; differentiable."""
    numbers = jnp.asarray(numbers)
    k = jnp.asarray(camera.intrinsics, numbers.dtype)
    fx, cx, cy = numbers[INTRINSICS]
    k = (k * (fx / k[0, 0])).at[:, 2].set(jnp.stack([cx, cy, jnp.ones_like(cx)]))
    pose = base_from_mounted_camera(numbers[MOUNT])
    lens = Lens(numbers[COEFFICIENTS], camera.lens.model)
    return dataclasses.replace(camera, intrinsics=k, base_from_camera=pose, lens=lens)


def coefficient_sigmas(camera: Camera, edge_px: float) -> Float[np.ndarray, " C"]:
    """Standard deviations of a lens's coefficients, each of which moves no point of the image by more than `edge_px`.

    So said, a belief means the same for every model of a lens, and for every power of the distance from the axis.
    """
    rays, shown = rays_of(camera, _grid(camera))
    k = jnp.asarray(camera.intrinsics, rays.dtype)

    def image(coefficients: Float[Array, " C"]) -> Float[Array, "G 2"]:
        return bend(Lens(coefficients, camera.lens.model), rays)[0] @ k[:2, :2].T

    moved = np.asarray(jax.jacfwd(image)(jnp.asarray(camera.lens.coefficients, rays.dtype)))
    return edge_px / np.linalg.norm(moved[np.asarray(shown)], axis=1).max(0)


def share_shown(camera: Camera) -> float:
    """Which share of the image the lens can show: less than 1 where its formula folds back inside."""
    return float(np.mean(rays_of(camera, _grid(camera))[1]))


def _grid(camera: Camera) -> Float[np.ndarray, "G 2"]:
    axes = (np.linspace(0, size - 1, GRID) for size in (camera.width, camera.height))
    return np.stack(np.meshgrid(*axes), -1).reshape(-1, 2)
