"""Bilinear resizing that maps corner pixels to corner pixels, torch's align_corners=True, as D2-Net and ALIKE do."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


@partial(jax.jit, static_argnames="size")
def resize(maps: Float[Array, "*n H W C"], size: tuple[int, int]) -> Float[Array, "*n h w C"]:
    """Resizes maps to (h, w); pixel i of h lies at i (H - 1) / (h - 1); no smoothing."""
    for axis, target in ((maps.ndim - 3, size[0]), (maps.ndim - 2, size[1])):
        source = maps.shape[axis]
        if source == target:
            continue
        position = np.linspace(0, source - 1, target) if target > 1 else np.zeros(1)
        low = np.clip(np.floor(position).astype(np.int32), 0, max(source - 2, 0))
        share = jnp.asarray(position - low, maps.dtype)
        share = share.reshape(-1, *(1,) * (maps.ndim - 1 - axis))[(None,) * axis]
        high = np.minimum(low + 1, source - 1)
        maps = jnp.take(maps, low, axis=axis) * (1 - share) + jnp.take(maps, high, axis=axis) * share
    return maps
