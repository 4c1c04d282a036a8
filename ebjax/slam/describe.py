"""From an image to all that the run needs of it: floor view, place map, features, 3D points."""

import dataclasses
import typing
from collections.abc import Mapping
from functools import partial

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, ArrayLike, Bool, Float, UInt8

from ebjax.features.extractor import Extractor
from ebjax.features.matching import Features
from ebjax.features.measure import lift
from ebjax.features.upright import ROOTSIFT
from ebjax.geometry.camera import Camera, backproject
from ebjax.geometry.homography import apply
from ebjax.geometry.warp import Taps, gather, taps
from ebjax.places.descriptor import Descriptor
from ebjax.places.rootsift_vlad import ROOTSIFT_VLAD
from ebjax.slam.view import RunView

SUPERSAMPLE = 2
"""Each view pixel averages so many samples a side: near floor is imaged finer than the view and would alias."""
OBSTACLE_M = (0.05, 0.02)
"""What rises above the floor by more than this, plus this share of its distance, is no floor: a wall, a leg."""


@typing.no_type_check
@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Landmarks:
    """The features of a frame, or with a leading axis of many, and where they lie in base."""

    features: Features
    floor_points: Float[Array, "*n K 2"]  # on the floor, m
    points: Float[Array, "*n K 3"]  # by depth, m
    range_m: Float[Array, "*n K"]  # depth of `points`; 0 where there is none


@typing.no_type_check
@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Described:
    """One frame, or with a leading axis many: the floor view, what tells its place, its landmarks."""

    view: UInt8[Array, "*n h w 3"]  # RGB
    floor: Bool[Array, "*n h w"]  # seen, and nothing stands there as far as depth knows
    place: Mapping[str, Array]  # what the global descriptor keeps of it
    landmarks: Landmarks
    turned: Landmarks | None  # of the view turned by pi, where the extractor has to look again


def clear_floor(depth_m: Float[Array, "H W"], view: RunView, camera: Camera) -> Bool[Array, "h w"]:
    """View pixels where depth shows floor or nothing at all; robust to a T_base_camera that is some degrees off."""
    height, width = view.size
    rows, columns = jnp.meshgrid(jnp.arange(height), jnp.arange(width), indexing="ij")
    grid = jnp.stack([columns.reshape(-1), rows.reshape(-1)], -1).astype(view.image_from_view.dtype)
    pixels = apply(view.image_from_view, grid)
    nearest = jnp.round(pixels).astype(jnp.int32)
    u, v = jnp.clip(nearest[:, 0], 0, camera.width - 1), jnp.clip(nearest[:, 1], 0, camera.height - 1)
    depth = depth_m[v, u]
    points = backproject(pixels, depth, camera.intrinsics)
    pose = jnp.asarray(camera.base_from_camera)
    up = points @ pose[2, :3] + pose[2, 3]
    standing = (depth > 0) & (up > OBSTACLE_M[0] + OBSTACLE_M[1] * depth)
    return view.seen & ~standing.reshape(height, width)


def view_taps(view: RunView, camera: Camera, dtype: DTypeLike = jnp.float32) -> Taps:
    """The samples of the supersampled view in the image, once for the run; differentiable in the view."""
    height, width = view.size
    fine = (SUPERSAMPLE * height, SUPERSAMPLE * width)
    offset = (1 - SUPERSAMPLE) / (2 * SUPERSAMPLE)
    view_from_fine = jnp.array([[1 / SUPERSAMPLE, 0, offset], [0, 1 / SUPERSAMPLE, offset], [0, 0, 1]])
    image_from_fine = view.image_from_view @ view_from_fine.astype(view.image_from_view.dtype)
    found = taps(image_from_fine.astype(dtype), fine, (camera.height, camera.width))
    return Taps(found.indices, found.weights.astype(dtype))


def floor_view(rgb: UInt8[Array, "H W C"] | Float[Array, "H W C"], samples: Taps) -> Float[Array, "h w C"]:
    """The floor from above, in [0, 1], averaged down from the supersampled warp."""
    # Without the barrier XLA gathers anew for every slice; a mean over reshaped axes is as slow.
    fine = jax.lax.optimization_barrier(gather(rgb, samples))
    rows, columns = range(SUPERSAMPLE), range(SUPERSAMPLE)
    return sum(fine[r::SUPERSAMPLE, c::SUPERSAMPLE] for r in rows for c in columns) / SUPERSAMPLE**2


@partial(jax.jit, static_argnames=("extractor", "descriptor"))
def _describe(
    rgb: UInt8[Array, "H W 3"],
    depth_m: Float[Array, "H W"],
    samples: Taps,
    view: RunView,
    camera: Camera,
    *,
    extractor: Extractor | None,
    descriptor: Descriptor | None,
) -> tuple[UInt8[Array, "h w 3"], Bool[Array, "h w"], Mapping[str, Array] | None, Landmarks | None]:
    """The view, its floor, and what may be computed in the same program."""
    colours = floor_view(rgb, samples)
    floor = clear_floor(depth_m.astype(view.image_from_view.dtype), view, camera)
    place = None if descriptor is None else descriptor.look(colours, floor, rgb)
    landmarks = None
    if extractor is not None:
        landmarks = _located(extractor.extract(colours, floor), floor, depth_m, view, camera)
    return jnp.round(colours * 255).astype(jnp.uint8), floor, place, landmarks


def _located(features: Features, floor, depth_m, view: RunView, camera: Camera) -> Landmarks:
    """Drops features that do not lie on the floor, and gives the others their floor points and 3D points."""
    row, column = (jnp.round(features.keypoints[:, k]).astype(jnp.int32) for k in (1, 0))
    features = dataclasses.replace(features, valid=features.valid & floor[row, column])
    keypoints = features.keypoints.astype(view.image_from_view.dtype)
    pixels = apply(view.image_from_view, keypoints)
    points, range_m = lift(pixels, depth_m.astype(pixels.dtype), camera)
    return Landmarks(features, apply(view.floor_from_view, keypoints), points, range_m)


_located_jit = jax.jit(_located)


def describe(
    rgb: UInt8[ArrayLike, "H W 3"],
    depth_m: Float[ArrayLike, "H W"],
    samples: Taps,
    view: RunView,
    camera: Camera,
    *,
    extractor: Extractor = ROOTSIFT,
    descriptor: Descriptor = ROOTSIFT_VLAD,
) -> Described:
    """Describes a frame.

    Args:
      rgb: the image.
      depth_m: along the optical axis, 0 = missing (all zero without a depth camera).
      samples: from `view_taps`.
      view: the run's floor view.
      camera: of the run.
      extractor: of local features.
      descriptor: of places.
    """
    rgb, depth_m = jnp.asarray(rgb), jnp.asarray(depth_m)
    inside = {
        "extractor": extractor if extractor.jitted else None,
        "descriptor": descriptor if descriptor.jitted else None,
    }
    shown, floor, place, landmarks = _describe(rgb, depth_m, samples, view, camera, **inside)
    # What both look at is one and the same array: an `Eye` looks once.
    colours, turned = shown.astype(jnp.float32) / 255, None
    if place is None:
        place = descriptor.look(colours, floor, rgb)
    if landmarks is None:

        def located(features: Features) -> Landmarks:
            return _located_jit(features, floor, depth_m, view, camera)

        landmarks = located(extractor.extract(colours, floor))
        turned = None if extractor.turn else located(extractor.turned(colours, floor))
    return Described(shown, floor, place, landmarks, turned)
