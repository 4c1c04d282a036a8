"""Corners of the whole image as an upright pinhole would see them, with their depth: what motions are measured from."""

from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Bool, Float, UInt8

from ebjax.features.measure import lift
from ebjax.geometry.camera import OUTSIDE_PX, Camera, ideal_from_raw, raw_slopes
from ebjax.odometry.image_matches import COUNT, LONGEST_SIDE, ImageFeatures, image_features

MOST_STRETCH = 4.0
"""Of a pinhole's image over a lens's: farther out, 60 degrees for a fisheye, corners say little."""
AHEAD = 0.1
"""Depth of the unit ray ahead of an upright camera below which a corner is left out."""

_lift = jax.jit(lift)


def image_corners(
    rgb: UInt8[np.ndarray, "H W 3"],
    depth_m: Float[np.ndarray, "H W"] | None,
    camera: Camera,
    mask: Bool[np.ndarray, "h w"] | None = None,
    level_from_base: Float[np.ndarray, "4 4"] | None = None,
    *,
    longest_side: int = LONGEST_SIDE,
) -> ImageFeatures:
    """Finds corners in a raw image and says where an ideal, upright camera would see them, and how deep.

    Args:
      rgb: the raw image.
      depth_m: of the same camera, m; 0 or not finite where missing.
      camera: as it is mounted.
      mask: where corners may lie; None: everywhere.
      level_from_base: how the robot leans; None: it does not.
      longest_side: as of `image_features`.
    """
    corners = with_depth(ideal(image_features(rgb, mask, longest_side=longest_side), camera), depth_m, camera)
    return corners if level_from_base is None else levelled(corners, camera, level_from_base)


def _padded(keypoints: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "M 2"]:
    """Filled up, so that one program serves all images."""
    padded = np.zeros((-(-max(len(keypoints), 1) // COUNT) * COUNT, 2))
    padded[: len(keypoints)] = keypoints
    return padded


def _rows(features: ImageFeatures, kept: np.ndarray, **changed: np.ndarray | None) -> ImageFeatures:
    rows = {name: None if (value := getattr(features, name)) is None else value[kept] for name in PER_CORNER}
    return replace(features, **rows | changed)


PER_CORNER = ("keypoints", "descriptors", "sizes_px", "stretch", "depth_m")


def ideal(features: ImageFeatures, camera: Camera) -> ImageFeatures:
    """The corners in ideal pixels, without those that a pinhole's image stretches more than four times."""
    if camera.lens.model == "pinhole":
        return features
    pixels = ideal_from_raw(camera, _padded(features.keypoints))
    slopes = np.linalg.norm(np.asarray(raw_slopes(camera, pixels)), ord=-2, axis=(1, 2))
    pixels, slopes = np.asarray(pixels)[: len(features)], slopes[: len(features)]
    kept = np.flatnonzero((pixels[:, 0] > OUTSIDE_PX / 2) & (slopes > 1 / MOST_STRETCH))
    return _rows(features, kept, keypoints=pixels[kept], stretch=np.maximum(1 / slopes[kept], 1.0))


def with_depth(features: ImageFeatures, depth_m: Float[np.ndarray, "H W"] | None, camera: Camera) -> ImageFeatures:
    """The corners, in ideal pixels, with what a depth image says at each."""
    if depth_m is None:
        return replace(features, depth_m=None)
    pixels = _padded(features.keypoints).astype(np.float32)
    depth = _lift(pixels, depth_m.astype(np.float32), camera)[1]
    return replace(features, depth_m=np.asarray(depth, np.float64)[: len(features)])


def compile_lifting(camera: Camera) -> None:
    """Makes the program that reads depth at corners before there are any; may run in a thread."""
    none = ImageFeatures(np.zeros((0, 2)), np.zeros((0, 128)), np.zeros(0))
    with_depth(none, np.zeros((camera.height, camera.width), np.float32), camera)


def levelled(features: ImageFeatures, camera: Camera, level_from_base: Float[np.ndarray, "4 4"]) -> ImageFeatures:
    """The corners where the camera of an upright robot would see them.

    Leaning by a degree moves the camera by a centimetre: corners without depth are taken as far away as the floor is
    along their rays, which is as far as they can be, or as infinitely far above the horizon.
    """
    level_from_camera = np.asarray(camera.base_from_camera, np.float64)
    leant = level_from_base @ level_from_camera
    seen_from_level = np.linalg.inv(level_from_camera) @ leant
    intrinsics = np.asarray(camera.intrinsics, np.float64)
    rays = np.column_stack([features.keypoints, np.ones(len(features))]) @ np.linalg.inv(intrinsics).T
    known = np.zeros(len(features), bool) if features.depth_m is None else features.depth_m > 0
    down = -(rays @ leant[2, :3])
    nearness = np.maximum(down, 0.0) / leant[2, 3]
    if features.depth_m is not None:
        nearness = np.where(known, 1 / np.where(known, features.depth_m, 1.0), nearness)
    turned = rays @ seen_from_level[:3, :3].T + nearness[:, None] * seen_from_level[:3, 3]
    kept = np.flatnonzero(turned[:, 2] > AHEAD)
    turned, known, nearness = turned[kept], known[kept], nearness[kept]
    pixels = (turned / turned[:, 2:]) @ intrinsics.T
    depth_m = None
    if features.depth_m is not None:
        depth_m = np.where(known, turned[:, 2] / np.where(known, nearness, 1.0), 0.0)
    return _rows(features, kept, keypoints=pixels[:, :2], depth_m=depth_m)
