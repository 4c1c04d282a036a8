"""The floor that depth images show, and the camera over it."""

import dataclasses
from collections.abc import Iterable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ebjax.geometry.camera import OUTSIDE_PX, Camera, backproject, ideal_from_raw
from ebjax.geometry.plane import camera_from_plane, fit_ground_plane

MIN_INLIERS = 0.1
"""Share of an image's depth that must lie on the plane."""


def floor_planes(
    depths: Iterable[Float[np.ndarray, "H W"] | None], camera: Camera, *, stride: int = 2, seed: int = 0
) -> Float[np.ndarray, "N 4"]:
    """The floor that each depth image shows, (n, d) in the camera's frame; NaN where it shows none, or there is none.

    Args:
      depths: m, 0 or not finite where missing.
      camera: of the images.
      stride: every so many rows and columns count.
      seed: of RANSAC.
    """
    rows, columns = np.mgrid[: camera.height : stride, : camera.width : stride]
    pixels = ideal_from_raw(camera, jnp.asarray(np.stack([columns.ravel(), rows.ravel()], 1), jnp.float32))
    shown = pixels[:, 0] > OUTSIDE_PX / 2
    planes = []
    for k, depth in enumerate(depths):
        planes.append(np.full(4, np.nan))
        if depth is None:
            continue
        values = jnp.where(shown, jnp.asarray(depth[::stride, ::stride].ravel(), jnp.float32), 0)
        points = backproject(pixels, values, jnp.asarray(camera.intrinsics, jnp.float32))
        plane, inliers = fit_ground_plane(points, values > 0, key=jax.random.key(seed + k))
        if inliers.sum() >= MIN_INLIERS * max(int((values > 0).sum()), 1) and plane[3] > 0:
            planes[-1] = np.asarray(plane, np.float64)
    return np.array(planes).reshape(-1, 4)


def camera_from_depth(
    depths: list[Float[np.ndarray, "H W"]], camera: Camera, *, seed: int = 0
) -> tuple[Camera, float, float, float]:
    """Fits the floor in several depth images and puts the camera over the median plane.

    Where the camera stands on the robot (x, y) stays as given; it is taken to look straight ahead.

    Returns:
      The camera, its height (m), pitch and roll (degrees).

    Raises:
      ValueError: no image shows a floor.
    """
    planes = floor_planes(depths, camera, seed=seed)
    planes = planes[np.isfinite(planes[:, 0])]
    if not len(planes):
        raise ValueError("no image shows a floor plane; check depth_scale in camera.json, or use --floor camera")
    plane = np.median(planes, axis=0)
    plane[:3] /= np.linalg.norm(plane[:3])
    where = np.asarray(camera.base_from_camera)[:2, 3]
    found = camera_from_plane(
        jnp.asarray(plane), jnp.asarray(camera.intrinsics), camera.width, camera.height, *map(float, where)
    )
    pitch = np.degrees(np.arcsin(-plane[2]))
    roll = np.degrees(np.arctan2(plane[0], -plane[1]))
    return dataclasses.replace(found, lens=camera.lens), float(plane[3]), float(pitch), float(roll)
