"""A keyframe described anew from what is kept of it: its floor view, and the depth of the features that it had."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.spatial import cKDTree

from ebjax.features.landmarks import Landmarks
from ebjax.geometry.camera import Camera
from ebjax.places.place import Kept, Place
from ebjax.slam.look import Eyes
from ebjax.slam.packed import FEATURES, TURNED, Arrays, floor_of, packed_features, packed_place, view_of
from ebjax.views.run_view import RunView

NEAR_PX = 3.0
"""A feature takes the height of the floor from the nearest one whose depth is kept, if that is so near in the view."""
PICTURES = ("view", "grey", "floor")
"""What is kept as it is; what is matched to a fraction of a pixel is the grey picture, which lost nothing."""


def look_again(kept: Arrays, eyes: Eyes, place: Callable[[Kept], Place]) -> dict[str, np.ndarray]:
    """The pictures, features and place of a keyframe.

    Args:
      kept: of the keyframe, its colour view among it.
      eyes: what it is looked at with; camera and view are those that saw it.
      place: makes a place of what the descriptor keeps.

    Raises:
      ValueError: a picture cannot be decoded.
    """
    pictures = {name: kept[name] for name in PICTURES}
    return pictures | described_again(view_of(kept), floor_of(kept), kept, eyes, place)


def described_again(
    shown: UInt8[np.ndarray, "h w 3"],
    floor: Bool[np.ndarray, "h w"],
    kept: Arrays,
    eyes: Eyes,
    place: Callable[[Kept], Place],
) -> dict[str, np.ndarray]:
    """The features and place of another picture of the floor that a keyframe saw.

    Args:
      shown: RGB.
      floor: what of it is floor.
      kept: features of the keyframe, with their depths.
      eyes: as of `look_again`.
      place: likewise.
    """
    described = jax.tree.map(np.asarray, eyes.describe_view(shown, floor))

    def with_depth(landmarks: Landmarks) -> Landmarks:
        range_m: Any = range_again(np.asarray(landmarks.features.keypoints), kept, eyes.view, eyes.camera)
        return dataclasses.replace(landmarks, range_m=range_m)

    turned = None if described.turned is None else with_depth(described.turned)
    described = dataclasses.replace(described, landmarks=with_depth(described.landmarks), turned=turned)
    return packed_features(described) | packed_place(place(described.place))


def range_again(
    keypoints: Float[np.ndarray, "K 2"], kept: Arrays, view: RunView, camera: Camera
) -> Float[np.ndarray, " K"]:
    """Depth of keypoints along the optical axis (m), by the height of the nearest kept feature; 0 where none is near.

    Args:
      keypoints: px of the view.
      kept: features of the same view, with their depths.
      view: of the floor.
      camera: that saw it.
    """
    names = [name for name in (FEATURES, TURNED) if f"{name}.range_m" in kept]
    was = np.concatenate([kept[f"{name}.keypoints"] for name in names])
    range_m = np.concatenate([kept[f"{name}.range_m"] for name in names])
    was, range_m = was[range_m > 0], range_m[range_m > 0]
    if not len(was):
        return np.zeros(len(keypoints))
    top = float(np.asarray(camera.base_from_camera)[2, 3])
    height = top + range_m * _rise(was, view, camera)
    apart, near = cKDTree(was).query(keypoints)
    found = (height[near] - top) / _rise(keypoints, view, camera)
    return np.where((apart <= NEAR_PX) & (found > 0), found, 0.0)


def _rise(keypoints: Float[np.ndarray, "K 2"], view: RunView, camera: Camera) -> Float[np.ndarray, " K"]:
    """How much higher above the floor one is by every metre along the optical axis, on the ray of a keypoint."""
    ray = np.column_stack([keypoints, np.ones(len(keypoints))]) @ np.asarray(view.image_from_view, np.float64).T
    ideal = (ray / ray[:, 2:]) @ np.linalg.inv(np.asarray(camera.intrinsics, np.float64)).T
    return ideal @ np.asarray(camera.base_from_camera, np.float64)[2, :3]
