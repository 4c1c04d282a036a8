"""XFeat (Potje et al., CVPR 2024): keypoints from 8 x 8 px cells, 64 numbers each from a map of 1/8 of the size.

Grey in any range to a descriptor, a reliability and 65 logits (64 places and none) for every cell.

    descriptors, logits, reliability = network(grey)    N h w 64, N h w 65, N h w
    found = detect(network, rgb, threshold=0.05)        keypoints, scores, descriptors

This is the sparse feature of the paper; the matcher that refines its dense one is left out. Where the published code
differs: of an image whose sides are no multiples of 32 px it scales keypoints about the corner of the image (here about
the corner of the first pixel, so that a turn by pi changes nothing), and it scores keypoints of the last row and
column 0.
"""

from collections.abc import Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Float

from ebjax.geometry.warp import sample_bilinear
from ebjax.models.checkpoint import taking
from ebjax.models.detect import Detections, strongest, window_max
from ebjax.models.layers import Precision, avg_pool, conv, normalise, relu
from ebjax.models.weights import folded_norm, kernel_from_torch

CELL, SIDE = 8, 32
RADIUS = 2
EPSILON = 1e-5
CUBIC = -0.75
STAGES = {
    "block1": (1, ((4, 3, 1), (8, 3, 2), (8, 3, 1), (24, 3, 2))),
    "block2": (24, ((24, 3, 1), (24, 3, 1))),
    "block3": (24, ((64, 3, 2), (64, 3, 1), (64, 1, 1))),
    "block4": (64, ((64, 3, 2), (64, 3, 1), (64, 3, 1))),
    "block5": (64, ((128, 3, 2), (128, 3, 1), (128, 3, 1), (64, 1, 1))),
    "block_fusion": (64, ((64, 3, 1), (64, 3, 1))),
    "heatmap_head": (64, ((64, 1, 1), (64, 1, 1))),
    "keypoint_head": (64, ((64, 1, 1), (64, 1, 1), (64, 1, 1))),
}
"""Channels that come in; of every convolution the channels that go out, its size and its stride."""
LAST = {"block_fusion": 64, "heatmap_head": 1, "keypoint_head": 65}
"""The stages that end in a 1x1 convolution without a ReLU, and its channels."""


class Stage(nnx.Module):
    """Convolutions with a ReLU each and, for the stages in LAST, a 1x1 convolution without."""

    def __init__(self, name: str, *, precision: Precision, rngs: nnx.Rngs):
        channels, layers = STAGES[name]
        options: dict[str, Any] = {"precision": precision, "rngs": rngs}
        self.count = len(layers)
        for n, (width, size, stride) in enumerate(layers):
            setattr(self, f"conv{n}", conv(channels, width, size, stride=stride, **options))
            channels = width
        self.last = conv(channels, LAST[name], 1, **options) if name in LAST else None

    def __call__(self, x: Float[Array, "N H W I"]) -> Float[Array, "N h w O"]:
        """The stage."""
        for n in range(self.count):
            x = relu(getattr(self, f"conv{n}")(x))
        return x if self.last is None else self.last(x)


class XFeat(nnx.Module):
    """N x H x W grey images, sides multiples of 32 px, to the maps of their cells.

    Args:
      precision: of the products; "highest" is float32, also on a GPU.
    """

    def __init__(self, *, precision: Precision = "highest", rngs: nnx.Rngs):
        self.skip = conv(1, 24, 1, precision=precision, rngs=rngs)
        options: dict[str, Any] = {"precision": precision, "rngs": rngs}
        self.block1, self.block2 = Stage("block1", **options), Stage("block2", **options)
        self.block3, self.block4 = Stage("block3", **options), Stage("block4", **options)
        self.block5, self.block_fusion = Stage("block5", **options), Stage("block_fusion", **options)
        self.heatmap_head, self.keypoint_head = Stage("heatmap_head", **options), Stage("keypoint_head", **options)

    def __call__(
        self, grey: Float[Array, "N H W"]
    ) -> tuple[Float[Array, "N h w 64"], Float[Array, "N h w 65"], Float[Array, "N h w"]]:
        """Descriptors (not unit), logits of the keypoint's place in the cell, and reliability in (0, 1).

        Raises:
          ValueError: a side is no multiple of 32 px.
        """
        if any(side % SIDE or not side for side in grey.shape[1:]):
            raise ValueError(f"images of {grey.shape[1:]} px: XFeat needs sides that are multiples of {SIDE}")
        mean, variance = grey.mean((1, 2), keepdims=True), grey.var((1, 2), keepdims=True)
        # The published network does not differentiate its normalisation.
        x = jax.lax.stop_gradient((grey - mean) / jnp.sqrt(variance + EPSILON))[..., None]
        x3 = self.block3(self.block2(self.block1(x) + self.skip(avg_pool(x, 4))))
        x4 = self.block4(x3)
        x5 = self.block5(x4)
        features = self.block_fusion(x3 + _resized(x4, x3.shape[1:3]) + _resized(x5, x3.shape[1:3]))
        return features, self.keypoint_head(_cells(x)), nnx.sigmoid(self.heatmap_head(features)[..., 0])


def _resized(x: Float[Array, "N H W C"], size: tuple[int, ...]) -> Float[Array, "N h w C"]:
    """Bilinear, half-pixel centres, no smoothing."""
    return jax.image.resize(x, (len(x), *size, x.shape[-1]), "linear", antialias=False)


def _cells(x: Float[Array, "N H W 1"]) -> Float[Array, "N h w 64"]:
    """The 8 x 8 px of every cell, row by row, as its channels."""
    batch, height, width = x.shape[:3]
    x = x.reshape(batch, height // CELL, CELL, width // CELL, CELL).transpose(0, 1, 3, 2, 4)
    return x.reshape(*x.shape[:3], CELL * CELL)


def keypoint_map(logits: Float[Array, "h w 65"]) -> Float[Array, "H W"]:
    """The probability that a pixel is the keypoint of its cell; 8 times the size of the cells' map."""
    height, width = logits.shape[:2]
    places = jax.nn.softmax(logits, -1)[..., :-1].reshape(height, width, CELL, CELL)
    return places.transpose(0, 2, 1, 3).reshape(height * CELL, width * CELL)


@jax.jit
def sample_bicubic(maps: Float[Array, "h w C"], points: Float[Array, "K 2"]) -> Float[Array, "K C"]:
    """Reads a map at (x, y) by Keys' cubic kernel with a = -0.75, zero outside, as torch's `grid_sample` does."""
    low = jnp.floor(points)
    steps = jnp.arange(-1, 3)
    distance = jnp.abs(points[:, None, :] - low[:, None, :] - steps[None, :, None])
    near = ((CUBIC + 2) * distance - (CUBIC + 3)) * distance**2 + 1
    far = ((CUBIC * distance - 5 * CUBIC) * distance + 8 * CUBIC) * distance - 4 * CUBIC
    weights = jnp.where(distance <= 1, near, far)
    places = low.astype(jnp.int32)[:, None, :] + steps[None, :, None]
    size = jnp.asarray([maps.shape[1], maps.shape[0]])
    weights = jnp.where((places >= 0) & (places < size[None, None, :]), weights, 0)
    places = jnp.clip(places, 0, size[None, None, :] - 1)
    values = maps[places[:, :, None, 1], places[:, None, :, 0]]
    return jnp.einsum("ki,kj,kijc->kc", weights[..., 1], weights[..., 0], values, precision="highest")


def detect(network: XFeat, image: Float[Array, "H W 3"], *, count: int = 4096, threshold: float = 0.05) -> Detections:
    """Detects and describes one image.

    Args:
      network: with its weights.
      image: RGB; looked at with its sides stretched to multiples of 32 px below.
      count: of rows, the keypoints of highest score (the published `top_k`); above H W every one.
      threshold: lowest probability of a keypoint.

    Raises:
      ValueError: a side is shorter than 32 px.
    """
    height, width = image.shape[:2]
    size = height // SIDE * SIDE, width // SIDE * SIDE
    grey = image.mean(-1)
    if size != (height, width):
        grey = _resized(grey[None, ..., None], size)[0, ..., 0] if all(size) else grey
    descriptors, logits, reliability = network(grey[None])
    found = detect_maps(descriptors[0], logits[0], reliability[0], count=count, threshold=threshold)
    scale = jnp.asarray([width / max(size[1], 1), height / max(size[0], 1)], image.dtype)
    keypoints = (found.keypoints + 0.5) * scale[None, :] - 0.5
    return Detections(keypoints, found.scores, found.descriptors, found.scale, found.valid)


@partial(jax.jit, static_argnames="count")
def detect_maps(
    descriptors: Float[Array, "h w 64"],
    logits: Float[Array, "h w 65"],
    reliability: Float[Array, "h w"],
    *,
    count: int,
    threshold: float | Float[Array, ""],
) -> Detections:
    """`detect`, from the maps of one image; keypoints in pixels of the image that the network saw."""
    heat = keypoint_map(logits)
    height, width = heat.shape
    # The published code scores the last row and column, and the first pixel, 0 or less.
    found = (heat == window_max(heat, RADIUS)) & (heat > threshold)
    found = found.at[-1].set(False).at[:, -1].set(False).at[0, 0].set(False)
    rows, columns = jnp.arange(height, dtype=heat.dtype), jnp.arange(width, dtype=heat.dtype)
    where = jnp.stack(jnp.broadcast_arrays(columns[None, :], rows[:, None]), -1)
    scores = heat * sample_bilinear(reliability[..., None], _in_cells(where, (height, width)))[..., 0]
    pixels, valid = strongest(scores, found & (scores > 0), count)
    places = _in_cells(pixels.astype(heat.dtype), (height, width))
    return Detections(
        keypoints=pixels.astype(heat.dtype),
        scores=scores[pixels[:, 1], pixels[:, 0]],
        descriptors=normalise(sample_bicubic(normalise(descriptors), places)),
        scale=jnp.ones_like(heat, shape=len(pixels)),
        valid=valid,
    )


def _in_cells(points: Float[Array, "*n 2"], size: tuple[int, int]) -> Float[Array, "*n 2"]:
    """Pixels (x, y) -> places in the map of cells as XFeat was trained: pixel 0 at -1/2, the last at h - 1/2."""
    height, width = size
    scale = jnp.asarray([width / CELL / (width - 1), height / CELL / (height - 1)], points.dtype)
    return points * jnp.broadcast_to(scale, points.shape) - 0.5


def xfeat(arrays: Mapping[str, np.ndarray] | None = None, *, rngs: nnx.Rngs) -> XFeat:
    """XFeat; there is one size of it."""
    del arrays
    return XFeat(rngs=rngs)


def recognise(state: Mapping[str, np.ndarray]) -> bool:
    """Whether these are the keys of xfeat.pt."""
    return {"skip1.1.weight", "block_fusion.2.weight", "keypoint_head.3.weight"} <= state.keys()


def convert(state: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The published keys and layouts to ours; batch normalisation becomes part of its convolution.

    Raises:
      ValueError: a key is missing, or is not one of them.
    """
    with taking(state, "fine_matcher.") as take:
        found = {"skip.kernel": kernel_from_torch(take("skip1.1.weight")), "skip.bias": take("skip1.1.bias")}
        for name, (_, layers) in STAGES.items():
            for n in range(len(layers)):
                kernel = kernel_from_torch(take(f"{name}.{n}.layer.0.weight"))
                mean, variance = (take(f"{name}.{n}.layer.1.running_{part}") for part in ("mean", "var"))
                found |= folded_norm(f"{name}.conv{n}", kernel, mean, variance, EPSILON)
            if name in LAST:
                found[f"{name}.last.kernel"] = kernel_from_torch(take(f"{name}.{len(layers)}.weight"))
                found[f"{name}.last.bias"] = take(f"{name}.{len(layers)}.bias")
    return found
