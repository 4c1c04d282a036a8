"""The camera over the floor that depth images show."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ebjax.geometry.camera import OUTSIDE_PX, Camera, backproject, ideal_from_raw
from ebjax.geometry.plane import camera_from_plane, fit_ground_plane

MIN_INLIERS = 0.1


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
    rows, columns = np.mgrid[: camera.height : 2, : camera.width : 2]
    pixels = ideal_from_raw(camera, jnp.asarray(np.stack([columns.ravel(), rows.ravel()], 1), jnp.float32))
    shown = pixels[:, 0] > OUTSIDE_PX / 2
    planes = []
    for k, depth in enumerate(depths):
        values = jnp.where(shown, jnp.asarray(depth[::2, ::2].ravel(), jnp.float32), 0)
        points = backproject(pixels, values, jnp.asarray(camera.intrinsics, jnp.float32))
        plane, inliers = fit_ground_plane(points, values > 0, key=jax.random.key(seed + k))
        if inliers.sum() >= MIN_INLIERS * max(int((values > 0).sum()), 1) and plane[3] > 0:
            planes.append(np.asarray(plane, np.float64))
    if not planes:
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
