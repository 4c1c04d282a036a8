"""The local features that can be selected by name. A new one is one file and one line here."""

import dataclasses
import importlib
from collections.abc import Callable
from typing import Any

EXTRACTORS = {
    "rootsift": "ebjax.features.upright:ROOTSIFT",
    "sift": "ebjax.features.opencv:SIFT",
    "orb": "ebjax.features.opencv:ORB",
}


@dataclasses.dataclass(frozen=True)
class Extractor:
    """A local feature.

    Attributes:
      extract: (grey "H W" in [0, 1], seen "H W" bool) -> Features of a fixed number of rows.
      turn: descriptors -> those of the same keypoints in the image turned by pi.
      jitted: whether `extract` may be called inside a jitted program (else it runs on the host).
    """

    extract: Callable[..., Any]
    turn: Callable[..., Any]
    jitted: bool


def extractor(name: str) -> Extractor:
    """Looks an extractor up and imports it.

    Raises:
      ValueError: the name is not one of `EXTRACTORS`.
    """
    if name not in EXTRACTORS:
        raise ValueError(f"extractor {name!r} is unknown; choose one of {', '.join(EXTRACTORS)}")
    module, attribute = EXTRACTORS[name].split(":")
    return getattr(importlib.import_module(module), attribute)
