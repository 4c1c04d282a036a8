"""The features of a frame with where they lie in base: on the floor, and by depth."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8

from ebjax.features.matching import Features
from ebjax.features.measure import lift
from ebjax.geometry.camera import Camera, backproject, image_from_floor
from ebjax.geometry.homography import apply
from ebjax.geometry.pytree import pytree
from ebjax.models.luma import luma
from ebjax.views.run_view import RunView


@pytree
class Landmarks:
    """The features of a frame, or with a leading axis of many, and where they lie in base."""

    features: Features
    floor_points: Float[Array, "*n K 2"]  # on the floor, m
    points: Float[Array, "*n K 3"]  # by depth, m
    range_m: Float[Array, "*n K"]  # depth of `points`; 0 where there is none
    pixels: Float[Array, "*n K 2"]  # ideal ones of the image, px
    grey: UInt8[Array, "*n h w"]  # the floor view they were found in


def located(
    features: Features,
    floor: Bool[Array, "h w"],
    depth_m: Float[Array, "H W"],
    colours: Float[Array, "h w 3"],
    view: RunView,
    camera: Camera,
) -> Landmarks:
    """Drops features that do not lie on the floor, and gives the others their floor points and 3D points."""
    row, column = (jnp.round(features.keypoints[:, k]).astype(jnp.int32) for k in (1, 0))
    features = dataclasses.replace(features, valid=features.valid & floor[row, column])
    keypoints = features.keypoints.astype(view.image_from_view.dtype)
    pixels = apply(view.image_from_view, keypoints)
    points, range_m = lift(pixels, depth_m.astype(pixels.dtype), camera)
    grey = jnp.round(luma(colours) * 255).astype(jnp.uint8)
    return Landmarks(features, apply(view.floor_from_view, keypoints), points, range_m, pixels, grey)


@jax.jit
def levelled(landmarks: Landmarks, view: RunView, camera: Camera) -> Landmarks:
    """What a tilted camera saw of one frame, as if the run's own had seen it: pixels and depths of the level camera."""
    pose = jnp.asarray(camera.base_from_camera, landmarks.points.dtype)
    ahead = (landmarks.points - pose[None, :3, 3]) @ pose[:3, 2]
    keypoints = landmarks.features.keypoints.astype(view.image_from_view.dtype)
    return dataclasses.replace(
        landmarks,
        pixels=apply(view.image_from_view, keypoints),
        range_m=jnp.where(landmarks.range_m > 0, ahead, 0).astype(landmarks.range_m.dtype),
    )


def take(landmarks: Landmarks, rows: Int[np.ndarray, " K"]) -> Landmarks:
    """Some keyframes' landmarks."""
    return jax.tree.map(lambda leaf: leaf[rows], landmarks)


def floor_error_m(landmarks: Landmarks) -> float:
    """Median height of the described floor points above z = 0 of base, m; 0 without depth."""
    height = landmarks.points[..., 2][landmarks.range_m > 0]
    return float(np.median(np.abs(height))) if height.size else 0.0


def remounted_landmarks(landmarks: Landmarks, camera: Camera) -> Landmarks:
    """Many keyframes' landmarks where another mount of the same camera puts them."""
    pixels, range_m = np.asarray(landmarks.pixels), np.asarray(landmarks.range_m)
    # Runs of other lengths share the program.
    more = (1 << max(6, (len(pixels) - 1).bit_length())) - len(pixels)
    filled = (np.pad(x, [(0, more)] + [(0, 0)] * (x.ndim - 1)) for x in (pixels, range_m))
    moved: Any = tuple(np.asarray(x)[: len(pixels)] for x in _mounted(*filled, camera))
    return jax.tree.map(np.asarray, dataclasses.replace(landmarks, floor_points=moved[0], points=moved[1]))


@jax.jit
def _mounted(pixels: Float[Array, "N K 2"], range_m: Float[Array, "N K"], camera: Camera):
    flat = pixels.reshape(-1, 2)
    floor = apply(jnp.linalg.inv(image_from_floor(camera)), flat)
    pose = jnp.asarray(camera.base_from_camera, flat.dtype)
    points = backproject(flat, range_m.reshape(-1), camera.intrinsics) @ pose[:3, :3].T + pose[None, :3, 3]
    return floor.reshape(pixels.shape), points.reshape(*pixels.shape[:2], 3)
