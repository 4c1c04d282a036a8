"""One source of floors, real or synthetic: its crops, what is seen of them again, and what is measured on both."""

from collections.abc import Mapping
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from ebjax.features.extractor import Extractor
from ebjax.io.cache import digest
from ebjax.paper import crop_features, crops
from ebjax.places.descriptor import Descriptor
from ebjax.viz import experiments

SHOWN = 6


class Source:
    """Images are made when first asked for.

    Args:
      photographs: by name.
      most: crops.
      seed: of viewpoints, light and vocabularies.

    Attributes:
      cut: the crops.
      settings: what all that is measured depends on.
    """

    def __init__(self, photographs: Mapping[str, UInt8[np.ndarray, "_ _ 3"]], most: int, *, seed: int):
        self._photographs, self._seed = photographs, seed
        self.cut = crops.cut(photographs, most)
        self.settings = {"seed": seed, "content": digest(*photographs.values()), "crops": len(self.cut)}

    @cached_property
    def _made(self) -> tuple[list[UInt8[np.ndarray, "S S 3"]], list[Float[np.ndarray, "3 3"]]]:
        return crops.images_of(self._photographs, self.cut, seed=self._seed)

    @lru_cache(maxsize=1)  # noqa: B019 - one or two sources a process
    def _kept(self, chosen: Descriptor) -> Mapping[str, np.ndarray]:
        return crops.describe(chosen, self._made[0])

    def recall(self, chosen: Descriptor, ranking: str) -> dict[str, float]:
        """As `crops.recall`."""
        return crops.recall(self._kept(chosen), chosen, ranking, seed=self._seed)

    def match(self, chosen: Extractor, most: int) -> dict[str, Any]:
        """As `crop_features.measure`, on an even choice of `most` crops."""
        images, motions = self._made
        some = np.unique(np.linspace(0, len(motions) - 1, min(most, len(motions))).round().astype(int))
        pairs = [crop_features.CropPair(images[k], images[len(motions) + k], motions[k]) for k in some]
        return crop_features.measure(chosen, pairs, seed=self._seed)

    def examples(self) -> bytes:
        """Some crops, what is seen of them again, and that turned by pi, as a PNG."""
        images, count = self._made[0], len(self.cut)
        rows = {}
        for k in np.linspace(0, count - 1, SHOWN).round().astype(int):
            query = images[count + k]
            rows[f"crop {k}"] = (images[k], query, np.ascontiguousarray(query[::-1, ::-1]))
        return experiments.image_grid(rows, ("database", "query", "turned by pi"))
