"""From an image to all that the run needs of it: floor view, place map, features, 3D points."""

import dataclasses
import typing
from collections.abc import Mapping
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float, UInt8

from ebjax.features.extractor import Extractor
from ebjax.features.landmarks import Landmarks, levelled, located
from ebjax.features.matching import Features
from ebjax.features.upright import ROOTSIFT
from ebjax.geometry.camera import Camera
from ebjax.geometry.warp import Taps
from ebjax.places.descriptor import Descriptor
from ebjax.places.rootsift_vlad import ROOTSIFT_VLAD
from ebjax.views.floor_view import clear_floor, floor_view
from ebjax.views.run_view import RunView


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

    def levelled(self, view: RunView, camera: Camera) -> "Described":
        """What a tilted camera saw, as if the run's own had seen it."""
        turned = None if self.turned is None else levelled(self.turned, view, camera)
        return dataclasses.replace(self, landmarks=levelled(self.landmarks, view, camera), turned=turned)


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
) -> tuple[
    UInt8[Array, "h w 3"], Float[Array, "h w 3"], Bool[Array, "h w"], Mapping[str, Array] | None, Landmarks | None
]:
    """The view, the same in [0, 1], its floor, and what may be computed in the same program."""
    colours = floor_view(rgb, samples)
    floor = clear_floor(depth_m.astype(view.image_from_view.dtype), view, camera)
    place = None if descriptor is None else descriptor.look(colours, floor, rgb)
    landmarks = None
    if extractor is not None:
        landmarks = located(extractor.extract(colours, floor), floor, depth_m, colours, view, camera)
    shown = jnp.round(colours * 255).astype(jnp.uint8)
    return shown, shown.astype(jnp.float32) / 255, floor, place, landmarks


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
    inside = {
        "extractor": extractor if extractor.jitted else None,
        "descriptor": descriptor if descriptor.jitted else None,
    }
    # What both look at is one and the same array, `colours`: an `Eye` looks once.
    shown, colours, floor, place, landmarks = _describe(rgb, depth_m, samples, view, camera, **inside)
    turned = None
    if place is None:
        place = descriptor.look(colours, floor, rgb)
    if landmarks is None:

        def here(features: Features) -> Landmarks:
            return _located(features, floor, depth_m, colours, view, camera)

        landmarks = here(extractor.extract(colours, floor))
        turned = None if extractor.turn else here(extractor.turned(colours, floor))
    return Described(shown, floor, place, landmarks, turned)
