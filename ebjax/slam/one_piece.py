"""Arrays that live long in one piece of memory each: many small ones among what comes and goes leave holes."""

from typing import TypeVar

import jax
import numpy as np

Tree = TypeVar("Tree")
ALIGNMENT = 64
"""Bytes; JAX takes arrays that begin at a multiple of it without copying them."""


def in_one_piece(tree: Tree) -> Tree:
    """The same arrays, of NumPy, one behind the other in memory of their own."""
    leaves, form = jax.tree.flatten(tree)
    arrays = [np.asarray(leaf) for leaf in leaves]
    ends = np.cumsum([-(-array.nbytes // ALIGNMENT) * ALIGNMENT for array in arrays]).tolist()
    room = np.empty((ends[-1] if ends else 0) + ALIGNMENT, np.uint8)
    room = room[-room.ctypes.data % ALIGNMENT :]
    kept = []
    for array, start in zip(arrays, [0, *ends], strict=False):
        kept.append(room[start : start + array.nbytes].view(array.dtype).reshape(array.shape))
        kept[-1][...] = array
    return jax.tree.unflatten(form, kept)
