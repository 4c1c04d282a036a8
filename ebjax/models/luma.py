"""The grey view that most descriptors read."""

import jax.numpy as jnp
from jaxtyping import Array, Float

LUMA = (0.299, 0.587, 0.114)


def luma(view: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
    """0.299 R + 0.587 G + 0.114 B (ITU-R BT.601)."""
    return view @ jnp.asarray(LUMA, view.dtype)
