"""From an image to all that the run needs of it: floor view, place map, features, 3D points."""

import dataclasses
from collections.abc import Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, UInt8

from ebjax.features.extractor import Extractor
from ebjax.features.landmarks import Landmarks, levelled, located
from ebjax.features.matching import Features
from ebjax.features.upright import ROOTSIFT
from ebjax.geometry.camera import Camera
from ebjax.geometry.pytree import pytree
from ebjax.geometry.warp import Taps
from ebjax.places.descriptor import Descriptor
from ebjax.places.rootsift_vlad import ROOTSIFT_VLAD
from ebjax.views.floor_view import clear_floor, floor_view
from ebjax.views.run_view import RunView


@pytree
class Described:
    """One frame, or with a leading axis many: the floor view, what tells its place, its landmarks."""

    view: UInt8[Array, "*n h w 3"]  # RGB
    floor: Bool[Array, "*n h w"]  # seen, and nothing stands there as far as depth knows
    place: Mapping[str, Array]  # what the global descriptor keeps of it
    landmarks: Landmarks
    turned: Landmarks | None  # of the view turned by pi, where the extractor has to look again

    def levelled(self, view: RunView, camera: Camera) -> "Described":
        """What a tilted camera saw, as if the run's own had seen it."""
        turned = None if self.turned is None else levelled(self.turned, view, camera)
        return dataclasses.replace(self, landmarks=levelled(self.landmarks, view, camera), turned=turned)


Made = tuple[Mapping[str, Array] | None, Landmarks | None]
"""What may be computed in the same program: the place, the landmarks."""


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
) -> tuple[UInt8[Array, "h w 3"], Float[Array, "h w 3"], Bool[Array, "h w"], Made]:
    """The view, the same in [0, 1], its floor, and what may be computed in the same program."""
    colours = floor_view(rgb, samples)
    floor = clear_floor(depth_m.astype(view.image_from_view.dtype), view, camera)
    made = _made(colours, floor, rgb, depth_m, view, camera, extractor, descriptor)
    shown = jnp.round(colours * 255).astype(jnp.uint8)
    return shown, shown.astype(jnp.float32) / 255, floor, made


def _made(colours, floor, rgb, depth_m, view, camera, extractor, descriptor) -> Made:
    place = None if descriptor is None else descriptor.look(colours, floor, rgb)
    landmarks = None
    if extractor is not None:
        landmarks = located(extractor.extract(colours, floor), floor, depth_m, colours, view, camera)
    return place, landmarks


_made_alone = jax.jit(_made, static_argnames=("extractor", "descriptor"))
_located = jax.jit(located)


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
    inside = _jitted(extractor, descriptor)
    shown, colours, floor, made = _describe(rgb, depth_m, samples, view, camera, **inside)
    return _described(shown, colours, floor, made, rgb, depth_m, view, camera, extractor, descriptor)


def describe_view(
    shown: UInt8[ArrayLike, "h w 3"],
    floor: Bool[ArrayLike, "h w"],
    view: RunView,
    camera: Camera,
    *,
    extractor: Extractor,
    descriptor: Descriptor,
) -> Described:
    """Describes a floor view that was kept; no depth is known of it.

    Args:
      shown: the view, RGB.
      floor: what of it is floor.
      view: that it is.
      camera: that saw it.
      extractor: of local features.
      descriptor: of places; one that looks at the floor alone.
    """
    colours, floor = jnp.asarray(shown, jnp.float32) / 255, jnp.asarray(floor)
    depth_m = np.zeros((camera.height, camera.width), np.float32)
    made = _made_alone(colours, floor, shown, depth_m, view, camera, **_jitted(extractor, descriptor))
    return _described(shown, colours, floor, made, shown, depth_m, view, camera, extractor, descriptor)


def _jitted(extractor: Extractor, descriptor: Descriptor) -> dict[str, Any]:
    return {
        "extractor": extractor if extractor.jitted else None,
        "descriptor": descriptor if descriptor.jitted else None,
    }


def _described(shown, colours, floor, made, rgb, depth_m, view, camera, extractor, descriptor) -> Described:
    # What both look at is one and the same array, `colours`: an `Eye` looks once.
    (place, landmarks), turned = made, None
    if place is None:
        place = descriptor.look(colours, floor, rgb)
    if landmarks is None:

        def here(features: Features) -> Landmarks:
            return _located(features, floor, depth_m, colours, view, camera)

        landmarks = here(extractor.extract(colours, floor))
        turned = None if extractor.turn else here(extractor.turned(colours, floor))
    return Described(shown, floor, place, landmarks, turned)
