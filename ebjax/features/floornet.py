"""floornet as a local feature: blobs, described by the network's local map.

A reference seen from the opposite side is not extracted again: its descriptors are those of the view, the odd half with
the other sign. A view of 400 px and more is also described at half its size, and so on, as by `upright`.
"""

from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ebjax.features.blobs import find_blobs
from ebjax.features.extractor import Extractor
from ebjax.features.matching import Features
from ebjax.features.upright import RADIUS_PX, VERSION, blobs_an_octave, halved, octaves
from ebjax.geometry.warp import sample_bilinear
from ebjax.models.eye import open_eye
from ebjax.models.fast import Arithmetic
from ebjax.models.floornet import parity
from ebjax.models.layers import normalise
from ebjax.models.luma import luma


def floornet(weights: Path | None, arithmetic: Arithmetic) -> Extractor:
    """The local feature, with the weights that `open_floornet` finds; it has one arithmetic."""
    eye = open_eye(weights)

    def extract(view: Float[Array, "H W 3"], seen: Bool[Array, "H W"]) -> Features:
        found, count = [], blobs_an_octave(*view.shape[:2])
        for octave in range(octaves(*view.shape[:2])):
            found.append(_described(view, seen, eye(view, seen).local, octave=octave, count=count))
            view, seen = _half(view, seen)
        return jax.tree.map(lambda *rows: jnp.concatenate(rows), *found)

    return Extractor(extract, jitted=False, turn=turn, weights=eye.path, octaves=octaves, version=VERSION)


@jax.jit
def _half(view: Float[Array, "H W 3"], seen: Bool[Array, "H W"]) -> tuple[Float[Array, "h w 3"], Bool[Array, "h w"]]:
    return halved(jnp.asarray(view)).mean((1, 3)), halved(jnp.asarray(seen)).all((1, 3))


@partial(jax.jit, static_argnames=("octave", "count"))
def _described(
    view: Float[Array, "H W 3"], seen: Bool[Array, "H W"], local: Float[Array, "k l D"], *, octave: int, count: int
) -> Features:
    """The strongest blobs, described; keypoints in pixels of the view that was halved `octave` times."""
    view = jnp.asarray(view)
    keypoints, _, valid = find_blobs(luma(view), seen, count=count, radius=RADIUS_PX)
    scale = jnp.array([local.shape[1] / view.shape[1], local.shape[0] / view.shape[0]], keypoints.dtype)
    descriptors = normalise(sample_bilinear(local, (keypoints + 0.5) * scale[None, :] - 0.5))
    return Features((keypoints + 0.5) * 2**octave - 0.5, descriptors, valid)


@jax.jit
def turn(descriptors: Float[Array, "*n D"]) -> Float[Array, "*n D"]:
    """The descriptors of the same keypoints in the view turned by pi."""
    return descriptors * jnp.broadcast_to(
        jnp.asarray(parity(descriptors.shape[-1]), descriptors.dtype), descriptors.shape
    )
