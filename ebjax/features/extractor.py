"""The local features that can be selected by name. A new one is one file and one line here, or one of your own.

One of your own is named `my_package.mine:NAME`, from anywhere; its code is then run. `ebjax.testing.check_extractor`
says whether it keeps to what is promised here.
"""

import dataclasses
import typing
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ebjax.features.matching import Features
from ebjax.models.fast import Arithmetic
from ebjax.parts import made

EXTRACTORS = {
    "floornet": "ebjax.features.floornet:floornet",
    "rootsift": "ebjax.features.upright:ROOTSIFT",
    "sift": "ebjax.features.opencv:SIFT",
    "orb": "ebjax.features.opencv:ORB",
    "surf": "ebjax.features.surf:SURF",
    "superpoint": "ebjax.features.networks:superpoint",
    "d2net": "ebjax.features.networks:d2net",
    "alike": "ebjax.features.networks:alike",
    "aliked": "ebjax.features.networks:aliked",
    "xfeat": "ebjax.features.networks:xfeat",
}
"""Each is an `Extractor` or, for a network, what makes one of its weights file and its arithmetic."""


@typing.runtime_checkable
class Extract(Protocol):
    """What finds the features of one view."""

    def __call__(self, view: Float[Array, "H W 3"], seen: Bool[Array, "H W"], /) -> Features:
        """A fixed number of rows; those that hold no feature are not valid.

        Args:
          view: of the floor, RGB in [0, 1].
          seen: the field of view; the rest must not matter.
        """
        ...


@typing.runtime_checkable
class Turn(Protocol):
    """What makes the descriptors of the turned view from those of the view as it is."""

    def __call__(self, descriptors: Float[Array, "*n D"], /) -> Float[Array, "*n D"]:
        """Those of the same keypoints in the view turned by pi."""
        ...


@dataclasses.dataclass(frozen=True)
class Extractor:
    """A local feature.

    Views that face each other are matched after turning one of them by pi (R_pi). Some features know their descriptors
    in the turned view from those they have; a network has to look again.

    Attributes:
      extract: see `Extract`.
      jitted: whether `extract` may be called inside a jitted program; else it is called from the host.
      turn: descriptors -> those of the same keypoints in the view turned by pi; None looks again.
      weights: the file they were read from.
      octaves: (height, width) of a view -> how many equal parts its rows have; None: one. The rows of a part come
        strongest first.
      version: raised when a view has other features than before, so that they are not mixed in a map.
    """

    extract: Extract
    jitted: bool
    turn: Turn | None
    weights: Path | None = None
    octaves: Callable[[int, int], int] | None = None
    version: int = 1

    def turned(self, view: Float[Array, "H W 3"], seen: Bool[Array, "H W"]) -> Features:
        """The features of the view turned by pi; keypoints in pixels of the view as it is."""
        if self.turn is not None:
            found = self.extract(view, seen)
            return dataclasses.replace(found, descriptors=self.turn(found.descriptors))
        found = self.extract(view[::-1, ::-1], seen[::-1, ::-1])
        last = jnp.asarray([view.shape[1] - 1, view.shape[0] - 1], found.keypoints.dtype)
        return dataclasses.replace(found, keypoints=last[None, :] - found.keypoints)


def unturned(descriptors: Float[Array, "*n D"]) -> Float[Array, "*n D"]:
    """The descriptors as they are: they do not change with orientation."""
    return descriptors


def extractor(name: str, weights: Path | None = None, arithmetic: Arithmetic = "exact") -> Extractor:
    """Looks an extractor up and imports it.

    Args:
      name: one of EXTRACTORS, or `my_package.mine:NAME`: an `Extractor`, or a function of (weights, arithmetic) that
        gives one.
      weights: of a network: a .safetensors file, or a folder that holds NAME.safetensors; None looks in the usual
        place, see `ebjax.models.locate`. The others need none.
      arithmetic: of a network, see there.

    Raises:
      ValueError: no such name, or no extractor; a network without weights, or with another's; a package that is not
        installed.
      OSError: the weights cannot be read.
    """
    try:
        return made("extractor", name, EXTRACTORS, Extractor, weights, arithmetic)
    except ImportError as error:
        raise ValueError(f'{name} needs {error.name}: pip install "ebjax[{name}]"') from None


def usable(
    names: Sequence[str], weights: Path | None = None, arithmetic: Arithmetic = "exact"
) -> tuple[dict[str, Extractor], dict[str, str]]:
    """Those of the named extractors that can be used here, and why each of the others cannot."""
    found, absent = {}, {}
    for name in names:
        try:
            found[name] = extractor(name, weights, arithmetic)
        except ValueError as error:
            absent[name] = str(error)
    return found, absent
