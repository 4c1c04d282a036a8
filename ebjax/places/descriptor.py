"""The global descriptors that can be selected by name. A new one is one file and one line here, or one of your own.

A descriptor works in two steps. `look` keeps of one view what it is told apart by, and knows no other view. `unite`
learns from all views of a run together what they have in common, and gives every view a unit vector as it is and one
as if it were turned by pi (R_pi); views are compared by the cosine of these.

One of your own is named `my_package.mine:NAME`, from anywhere; its code is then run. The least it needs is a `look`
that gives "vector" and "turned", float32; `ebjax.testing.check_descriptor` says whether it keeps to all of this.
"""

import dataclasses
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, UInt8

from ebjax.models.fast import Arithmetic
from ebjax.parts import made
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
"""Each is a `Descriptor` or, for a network, what makes one of its weights file and its arithmetic (`Make`)."""


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


@typing.runtime_checkable
class Look(Protocol):
    """What a descriptor keeps of one view."""

    def __call__(
        self, view: Float[Array, "H W 3"], seen: Bool[Array, "H W"], image: UInt8[ArrayLike, "I J 3"], /
    ) -> Mapping[str, Array]:
        """Arrays by name, of one shape and dtype for all views of one size.

        Args:
          view: of the floor, RGB in [0, 1].
          seen: what of it is floor; the rest must not matter.
          image: the whole image that the view was taken from.
        """
        ...


@typing.runtime_checkable
class Unite(Protocol):
    """What makes vectors of all views of a run."""

    def __call__(self, kept: Mapping[str, np.ndarray], /, *, seed: int) -> Places:
        """Unit vectors of every view, as it is and turned by pi.

        Args:
          kept: what `look` gave, stacked over the views.
          seed: of anything random.
        """
        ...


@typing.runtime_checkable
class Make(Protocol):
    """What makes a descriptor that reads a network."""

    def __call__(self, weights: Path | None, arithmetic: Arithmetic, /) -> "Descriptor":
        """The descriptor, with weights from a file, None: from the usual place; see `ebjax.models.locate`."""
        ...


def unite_vectors(kept: Mapping[str, np.ndarray], /, *, seed: int = 0) -> Places:
    """The vectors that `look` gave, "vector" of the view as it is and "turned"; nothing is learned from the run."""
    return Places(jnp.stack([jnp.asarray(kept["vector"]), jnp.asarray(kept["turned"])], -1))


@dataclasses.dataclass(frozen=True)
class Descriptor:
    """A global descriptor.

    Attributes:
      look: see `Look`.
      unite: see `Unite`; as it is, `look` gives "vector" and "turned".
      jitted: whether `look` may be called inside a jitted program; else it is called from the host.
      has_maps: whether `unite` gives maps that can be correlated; the engine correlates those of ours only.
      whole_image: whether `look` uses the whole image too, which a map does not keep.
      side_px: the longer side that a view should have, where that is free to choose.
      weights: the file they were read from.
    """

    look: Look
    unite: Unite = unite_vectors
    jitted: bool = True
    has_maps: bool = False
    whole_image: bool = False
    side_px: int = 200
    weights: Path | None = None


def descriptor(name: str, weights: Path | None = None, arithmetic: Arithmetic = "exact") -> Descriptor:
    """Looks a descriptor up and imports it.

    Args:
      name: one of DESCRIPTORS, or `my_package.mine:NAME`: a `Descriptor`, or what makes one (`Make`).
      weights: of a network: a .safetensors file, or a folder that holds NAME.safetensors; None looks in the usual
        place, see `ebjax.models.locate`. The others need none.
      arithmetic: of a network, see there.

    Raises:
      ValueError: no such name, or no descriptor; a network without weights, or with another's.
      OSError: the weights cannot be read.
    """
    return made("descriptor", name, DESCRIPTORS, Descriptor, weights, arithmetic)
