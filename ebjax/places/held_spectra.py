"""The spectra of maps that were compared last, in slots of one array; others are transformed when they are asked for.

A view shows much of what the one before showed, so that most of the places it resembles were just looked up.
"""

from collections import OrderedDict
from collections.abc import Callable
from functools import partial

import jax
import numpy as np
from jaxtyping import Array, Int, Int8, UInt8

from ebjax.places.pairwise import Spectra, spectrum

SLOTS = 256
"""About 90 MB for maps of 25 x 25 cells and 32 channels."""
MapsOf = Callable[[Int[np.ndarray, "K"]], tuple[Int8[np.ndarray, "K h w D"], UInt8[np.ndarray, "K h w"]]]
"""Rows -> maps and weights of their places."""


@partial(jax.jit, donate_argnums=0)
def _put(held: Spectra, slot: Int[Array, ""], one: Spectra) -> Spectra:
    return jax.tree.map(lambda all_, new: all_.at[slot].set(new), held, one)


class HeldSpectra:
    """See above.

    Args:
      maps_of: reads the maps of rows.
    """

    def __init__(self, maps_of: MapsOf):
        self._maps_of = maps_of
        self._slot: OrderedDict[int, int] = OrderedDict()
        self.held: Spectra | None = None

    def slots(self, rows: Int[np.ndarray, "K"]) -> Int[np.ndarray, "K"]:
        """Where the spectra of rows are in `held`, SLOTS rows at most."""
        wanted = [int(row) for row in rows]
        for row in wanted:
            if row in self._slot:
                self._slot.move_to_end(row)
        missing = list(dict.fromkeys(row for row in wanted if row not in self._slot))
        if missing:
            for row, values, weights in zip(missing, *self._maps_of(np.array(missing)), strict=True):
                self._take(row, spectrum(values, weights))
        return np.array([self._slot[row] for row in wanted], np.int64)

    def _take(self, row: int, one: Spectra) -> None:
        if self.held is None:
            self.held = jax.tree.map(lambda leaf: jax.device_put(np.zeros((SLOTS, *leaf.shape), leaf.dtype)), one)
        slot = len(self._slot) if len(self._slot) < SLOTS else self._slot.popitem(last=False)[1]
        self.held = _put(self.held, np.int64(slot), one)
        self._slot[row] = slot
