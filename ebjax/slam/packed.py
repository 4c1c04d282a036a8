"""What is kept of a keyframe, about 95 kB: its floor view, its features, its place; and what is made of that again.

Descriptors and place maps are kept in 8 bits, each array with one scale, and the floor view as JPEG. What is matched
and compared is always what was kept, so that a run gives the same whether its keyframes are in memory or in a file.
"""

from collections.abc import Callable, Mapping
from functools import partial

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int8, UInt8

from ebjax.features.landmarks import Landmarks
from ebjax.features.matching import Features
from ebjax.geometry.camera import Camera, backproject
from ebjax.geometry.homography import apply
from ebjax.places.place import Place
from ebjax.slam.describe import Described
from ebjax.views.run_view import RunView

Arrays = Mapping[str, np.ndarray]
JPEG_QUALITY, PNG_COMPRESSION = 95, 1
FEATURES, TURNED = "features", "turned"


def packed(one: Described) -> dict[str, np.ndarray]:
    """One described frame, place apart."""
    pictures = (np.asarray(part) for part in (one.view, one.landmarks.grey, one.floor))
    return packed_pictures(*pictures) | packed_features(one)


def packed_pictures(
    view: UInt8[np.ndarray, "h w 3"], grey: UInt8[np.ndarray, "h w"], floor: Bool[np.ndarray, "h w"]
) -> dict[str, np.ndarray]:
    """The floor view, RGB and grey, and what of it is floor."""
    return {
        "view": _encoded(".jpg", view[..., ::-1], cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY),
        "grey": _encoded(".png", grey, cv2.IMWRITE_PNG_COMPRESSION, PNG_COMPRESSION),
        "floor": _encoded(".png", floor.astype(np.uint8) * 255, cv2.IMWRITE_PNG_BILEVEL, 1),
    }


def packed_features(one: Described) -> dict[str, np.ndarray]:
    """The features of a described frame, and those of its view turned by pi where that was looked at by itself."""
    kept: dict[str, np.ndarray] = {}
    for name, landmarks in ((FEATURES, one.landmarks), (TURNED, one.turned)):
        if landmarks is not None:
            kept |= {f"{name}.{key}": value for key, value in _features(landmarks).items()}
    return kept


def _features(landmarks: Landmarks) -> dict[str, np.ndarray]:
    features = landmarks.features
    valid = np.asarray(features.valid)
    descriptors, scale = quantised(np.asarray(features.descriptors)[valid])
    return {
        "rows": np.array(len(valid), np.int32),
        "keypoints": np.asarray(features.keypoints, np.float32)[valid],
        "descriptors": descriptors,
        "scale": scale,
        "range_m": np.asarray(landmarks.range_m, np.float32)[valid],
    }


def quantised(values: Float[np.ndarray, "*n"]) -> tuple[Int8[np.ndarray, "*n"], Float[np.ndarray, ""]]:
    """Whole numbers within 127 and the scale that turns them back."""
    scale = np.array(max(float(np.abs(values).max(initial=0)), 1e-12) / 127, np.float32)
    return np.rint(values / scale).astype(np.int8), scale


def packed_place(place: Place) -> dict[str, np.ndarray]:
    """The place of a frame."""
    parts = {"vector": place.vector, "turned": place.turned, "map": place.map, "weight": place.weight}
    return {f"place.{name}": value for name, value in parts.items() if value is not None}


def place_of(kept: Arrays) -> Place:
    """The same again; its scale says nothing."""
    return Place(*(kept.get(f"place.{name}") for name in ("vector", "turned", "map", "weight")))  # type: ignore[arg-type]


def view_of(kept: Arrays) -> UInt8[np.ndarray, "h w 3"]:
    """The floor view, RGB; grey where the colours were dropped."""
    if "view" not in kept:
        return np.repeat(_decoded(kept["grey"], cv2.IMREAD_GRAYSCALE)[..., None], 3, 2)
    return np.ascontiguousarray(_decoded(kept["view"], cv2.IMREAD_COLOR)[..., ::-1])


def floor_of(kept: Arrays) -> Bool[np.ndarray, "h w"]:
    """What of it is floor as far as is known."""
    return _decoded(kept["floor"], cv2.IMREAD_GRAYSCALE) > 0


def landmarks_of(kept: Arrays, view: RunView, camera: Camera, turn: Callable | None, facing: bool) -> Landmarks:
    """The features and where they lie in base.

    Args:
      kept: from `packed`.
      view: of the run.
      camera: as it is mounted.
      turn: of the extractor; None where the view turned by pi was looked at by itself.
      facing: whether those of the view turned by pi are wanted.
    """
    name = TURNED if facing and turn is None else FEATURES
    rows, valid = int(kept[f"{name}.rows"]), len(kept[f"{name}.keypoints"])

    def filled(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values, np.zeros((rows - valid, *values.shape[1:]), values.dtype)])

    parts = (filled(kept[f"{name}.{key}"]) for key in ("keypoints", "descriptors", "range_m"))
    grey = _decoded(kept["grey"], cv2.IMREAD_GRAYSCALE)
    turning = turn if facing else None
    return _restored(*parts, kept[f"{name}.scale"], np.arange(rows) < valid, grey, view, camera, turning)


@partial(jax.jit, static_argnames="turn")
def _restored(
    keypoints: Float[Array, "K 2"],
    descriptors: Int8[Array, "K D"],
    range_m: Float[Array, " K"],
    scale: Float[Array, ""],
    valid: Bool[Array, " K"],
    grey: UInt8[Array, "h w"],
    view: RunView,
    camera: Camera,
    turn: Callable | None,
) -> Landmarks:
    dtype = view.image_from_view.dtype
    values = descriptors.astype(jnp.float32) * scale
    features = Features(keypoints, values if turn is None else turn(values), valid)
    pixels = apply(view.image_from_view, keypoints.astype(dtype))
    range_m = range_m.astype(dtype)
    pose = jnp.asarray(camera.base_from_camera, dtype)
    points = backproject(pixels, range_m, camera.intrinsics) @ pose[:3, :3].T + pose[None, :3, 3]
    return Landmarks(features, apply(view.floor_from_view, keypoints.astype(dtype)), points, range_m, pixels, grey)


def _encoded(kind: str, image: np.ndarray, option: int, value: int) -> UInt8[np.ndarray, " n"]:
    done, data = cv2.imencode(kind, image, [option, value])
    if not done:
        raise ValueError(f"a floor view of {image.shape[1]} x {image.shape[0]} px cannot be encoded as {kind}")
    return data.ravel()


def _decoded(data: UInt8[np.ndarray, " n"], how: int) -> np.ndarray:
    image = cv2.imdecode(data, how)
    if image is None:
        raise ValueError("a kept floor view cannot be decoded")
    return np.asarray(image)
