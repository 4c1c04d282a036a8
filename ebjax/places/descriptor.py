"""The global descriptors that can be selected by name. A new one is one file and one line here.

A descriptor works in two steps. `look` keeps of one view what it is told apart by, and knows no other view. `unite`
learns from all views of a run together what they have in common, and gives every view a unit vector as it is and one
as if it were turned by pi (R_pi); views are compared by the cosine of these.
"""

import dataclasses
import functools
import importlib
import typing
from collections.abc import Callable, Mapping
from pathlib import Path

from jaxtyping import Array, Float

from ebjax.models.fast import Arithmetic
from ebjax.places.descriptor_map import MapSpace

DESCRIPTORS = {
    "floornet": "ebjax.places.floornet:floornet",
    "rootsift-vlad": "ebjax.places.rootsift_vlad:ROOTSIFT_VLAD",
    "hog": "ebjax.places.hog:HOG",
    "joint": "ebjax.places.joint:joint",
    "netvlad": "ebjax.places.netvlad:netvlad",
    "superpoint": "ebjax.places.superpoint:superpoint",
    "resnet50": "ebjax.places.backbones:resnet50",
    "resnet50-pooled": "ebjax.places.backbones:resnet50_pooled",
    "vgg19": "ebjax.places.backbones:vgg19",
    "vgg19-pooled": "ebjax.places.backbones:vgg19_pooled",
}
"""Each is a `Descriptor` or, for a network, a function of its weights file and its arithmetic that gives one."""


@typing.no_type_check
@dataclasses.dataclass(frozen=True)
class Places:
    """All views of a run: unit vectors as they are ([..., 0]) and turned by pi ([..., 1]).

    `maps` and `space` are there where the descriptor is made of a map that can be correlated; `share` says how much of
    the cosine of two views comes from it.
    """

    vectors: Float[Array, "N V 2"]
    maps: Float[Array, "N h w D"] | None = None
    space: MapSpace | None = None
    share: float | int = 1


@dataclasses.dataclass(frozen=True)
class Descriptor:
    """A global descriptor.

    Attributes:
      look: (view "H W 3", RGB in [0, 1]; seen "H W" bool, what of it is floor; image "I J 3" uint8, the whole image the
        view was taken from) -> arrays by name, of one shape for all views of one size.
      unite: (those arrays, stacked over the views of a run; seed=int) -> Places.
      jitted: whether `look` may be called inside a jitted program; else it is called from the host.
      has_maps: whether `unite` gives maps that can be correlated.
      side_px: the longer side that a view should have, where that is free to choose.
      weights: the file they were read from.
    """

    look: Callable[..., Mapping[str, Array]]
    unite: Callable[..., Places]
    jitted: bool = True
    has_maps: bool = False
    side_px: int = 200
    weights: Path | None = None


@functools.cache
def descriptor(name: str, weights: Path | None = None, arithmetic: Arithmetic = "exact") -> Descriptor:
    """Looks a descriptor up and imports it.

    Args:
      name: one of DESCRIPTORS.
      weights: of a network: a .safetensors file, or a folder that holds NAME.safetensors; None looks in the usual
        place, see `ebjax.models.locate`. The others need none.
      arithmetic: of a network, see there.

    Raises:
      ValueError: no such name; a network without weights, or with another's.
      OSError: the weights cannot be read.
    """
    if name not in DESCRIPTORS:
        raise ValueError(f"descriptor {name!r} is unknown; choose one of {', '.join(DESCRIPTORS)}")
    module, attribute = DESCRIPTORS[name].split(":")
    found = getattr(importlib.import_module(module), attribute)
    return found if isinstance(found, Descriptor) else found(weights, arithmetic)
