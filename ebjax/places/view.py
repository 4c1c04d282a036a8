"""What descriptors do to a view before they look at it. RGB in [0, 1]; `seen` is 1 where the view shows the floor."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

MIN_SHARE = 0.5


def filled(view: Float[Array, "H W C"], seen: Float[Array, "H W"]) -> Float[Array, "H W C"]:
    """The view with its mean colour where nothing is seen: a black border would be the strongest edge in it."""
    weight = seen[..., None]
    mean = (view * weight).sum((0, 1), keepdims=True) / jnp.maximum(weight.sum(), 1)
    return view * weight + mean * (1 - weight)


def resized(view: Float[Array, "H W C"], side_px: int) -> Float[Array, "h w C"]:
    """The view with a longer side of `side_px`, smoothed before it is made smaller."""
    scale = side_px / max(view.shape[:2])
    height, width = (max(1, round(scale * length)) for length in view.shape[:2])
    return jax.image.resize(view, (height, width, view.shape[2]), "linear")


def cells_seen(seen: Float[Array, "B H W"], size: tuple[int, ...]) -> Bool[Array, "B h w"]:
    """Which cells of a map of (h, w) over the view are at least half seen."""
    return jax.image.resize(seen, (len(seen), *size), "linear") >= MIN_SHARE


def unit(vectors: Float[Array, "*n V"]) -> Float[Array, "*n V"]:
    """Vectors of unit length; zero stays zero."""
    return vectors / jnp.maximum(jnp.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)
