"""SuperPoint (DeTone et al., CVPRW 2018): one encoder, a head that says where keypoints are, one that describes them.

Grey images in [0, 1] to logits of the 64 pixels of each 8x8 cell and of none of them, and to a descriptor a cell. What
follows, and how descriptors are read between cells, differs between the codes people use: see CONVENTIONS.

    logits, coarse = network(grey)                                  N h w 65, N h w 256
    found = detect(network, grey[0], CONVENTIONS["superglue"])      keypoints, scores, descriptors
"""

import dataclasses
from collections.abc import Mapping
from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Bool, Float

from ebjax.models.detect import Detections, inside, read_descriptors, strongest, suppress_greedily, suppress_twice
from ebjax.models.layers import Precision, conv, max_pool, normalise, relu
from ebjax.models.weights import kernel_from_torch

CELL = 8
ENCODER = {"1a": 64, "1b": 64, "2a": 64, "2b": 64, "3a": 128, "3b": 128, "4a": 128, "4b": 128}
EPSILON_V6 = 1e-3


@dataclasses.dataclass(frozen=True)
class Convention:
    """What one published code makes of the network's maps.

    Attributes:
      nms: "greedy" (best first) or "max-pool" (local maxima, and twice those of the rest).
      radius: of the square in which one keypoint stays, px.
      threshold: lowest score.
      border: keypoints closer to the border are left out, px: of the image for "greedy", else of the whole cells.
      sampling: where pixel x of an image of W px (w cells) lies among the cells:
        "image"    x w / W - 1/2, Magic Leap's code under torch >= 1.3
        "corners"  x (w - 1) / W, the same under the torch it was published with
        "cells"    (x - 3.5) (w - 1) / (8 w - 4.5), SuperGlue and hloc
        "exact"    (x + 1/2) / 8 - 1/2, rpautrat's, and hloc with fix_sampling
      epsilon: added to the softmax's denominator, of exp(logits) as they are.
    """

    nms: Literal["greedy", "max-pool"]
    radius: int
    threshold: float
    border: int
    sampling: Literal["image", "corners", "cells", "exact"]
    epsilon: float = 0.0


CONVENTIONS = {
    "magicleap": Convention("greedy", 4, 0.015, 4, "image", 1e-5),
    "superglue": Convention("max-pool", 4, 0.005, 4, "cells"),
    "v6": Convention("max-pool", 4, 0.005, 4, "exact"),
}
"""Magic Leap's demo; SuperGlue's and hloc's copy of the network; rpautrat's network trained anew (weights v6)."""


class Layer(nnx.Module):
    """relu(conv(x)), in v6 times `gain` plus `shift`: its batch normalisation comes after the ReLU."""

    def __init__(self, channels_in: int, channels_out: int, *, affine: bool, precision: Precision, rngs: nnx.Rngs):
        self.conv = conv(channels_in, channels_out, precision=precision, rngs=rngs)
        self.gain = nnx.Param(jnp.ones(channels_out, jnp.float32)) if affine else None
        self.shift = nnx.Param(jnp.zeros(channels_out, jnp.float32)) if affine else None

    def __call__(self, x: Float[Array, "N H W I"]) -> Float[Array, "N H W O"]:
        """One layer."""
        x = relu(self.conv(x))
        if self.gain is None or self.shift is None:
            return x
        return x * self.gain[...][None, None, None, :] + self.shift[...][None, None, None, :]


class SuperPoint(nnx.Module):
    """N x H x W x 1 grey to maps of H // 8 x W // 8 cells.

    Args:
      affine: whether layers end with a gain and a shift (v6) or not (v1).
      precision: of the products; "highest" is float32, also on a GPU.
    """

    def __init__(self, *, affine: bool = False, precision: Precision = "highest", rngs: nnx.Rngs):
        channels = 1
        for name, width in ENCODER.items():
            setattr(self, f"layer{name}", Layer(channels, width, affine=affine, precision=precision, rngs=rngs))
            channels = width
        self.layerPa = Layer(channels, 256, affine=affine, precision=precision, rngs=rngs)
        self.convPb = conv(256, CELL**2 + 1, 1, precision=precision, rngs=rngs)
        self.layerDa = Layer(channels, 256, affine=affine, precision=precision, rngs=rngs)
        self.convDb = conv(256, 256, 1, precision=precision, rngs=rngs)

    def __call__(self, grey: Float[Array, "N H W 1"]) -> tuple[Float[Array, "N h w 65"], Float[Array, "N h w 256"]]:
        """The logits, and the unit descriptors."""
        x = self.encode(grey)
        return self.convPb(self.layerPa(x)), normalise(self.convDb(self.layerDa(x)))

    def encode(self, grey: Float[Array, "N H W 1"], last: str = "4b") -> Float[Array, "N h w C"]:
        """The encoder's map after one of its layers, "1a" to "4b"."""
        x = grey
        for name in ENCODER:
            if name in ("2a", "3a", "4a"):
                x = max_pool(x)
            x = getattr(self, f"layer{name}")(x)
            if name == last:
                return x
        raise ValueError(f"no layer {last!r}; there are {', '.join(ENCODER)}")


def score_map(logits: Float[Array, "h w 65"], epsilon: float = 0.0) -> Float[Array, "H W"]:
    """Softmax, exp(logits) / (sum exp(logits) + epsilon); the 64 channels that are pixels are put in their places."""
    top = jax.lax.stop_gradient(logits.max(-1, keepdims=True))
    exponential = jnp.exp(logits - top)
    # The published code does not subtract the maximum, and gives NaN for logits above 88.
    total = exponential.sum(-1, keepdims=True) + (epsilon * jnp.exp(-top) if epsilon else 0)
    height, width, _ = logits.shape
    cells = (exponential / total)[..., :-1].reshape(height, width, CELL, CELL)
    return cells.transpose(0, 2, 1, 3).reshape(height * CELL, width * CELL)


def keypoint_mask(scores: Float[Array, "H W"], convention: Convention, size: tuple[int, int]) -> Bool[Array, "H W"]:
    """Which pixels of the score map are keypoints; `size` is the image's (height, width), which may be larger."""
    over = scores >= convention.threshold
    if convention.nms == "greedy":
        found = suppress_greedily(scores, over, convention.radius)
        beyond = [convention.border - (whole - part) for whole, part in zip(size, scores.shape, strict=True)]
    else:
        found = suppress_twice(scores, convention.radius) & over
        beyond = [convention.border] * 2
    return found & inside(scores.shape, convention.border, beyond)


def cell_from_pixel(
    pixels: Float[Array, "K 2"], sampling: str, cells: tuple[int, int], size: tuple[int, int]
) -> Float[Array, "K 2"]:
    """(x, y) px to (x, y) among the cells, whose centres are at integers; `cells` and `size` are (height, width)."""
    count = jnp.asarray(cells[::-1], pixels.dtype)[None, :]
    length = jnp.asarray(size[::-1], pixels.dtype)[None, :]
    if sampling == "image":
        return pixels * count / length - 0.5
    if sampling == "corners":
        return pixels * (count - 1) / length
    if sampling == "cells":
        return (pixels - 3.5) * (count - 1) / (CELL * count - 4.5)
    return (pixels + 0.5) / CELL - 0.5


def detect(
    network: SuperPoint, grey: Float[Array, "H W 1"], convention: Convention, *, count: int = 1000
) -> Detections:
    """Detects and describes one image.

    Args:
      network: of the convention.
      grey: in [0, 1]; at least 8 px a side, and what exceeds a multiple of 8 is not looked at.
      convention: one of CONVENTIONS, or another.
      count: of rows, the keypoints of highest score; above H W every one.
    """
    logits, coarse = network(grey[None])
    return detect_maps(logits[0], coarse[0], (grey.shape[0], grey.shape[1]), convention, count=count)


@partial(jax.jit, static_argnames=("size", "convention", "count"))
def detect_maps(
    logits: Float[Array, "h w 65"],
    coarse: Float[Array, "h w 256"],
    size: tuple[int, int],
    convention: Convention,
    *,
    count: int,
) -> Detections:
    """`detect`, from the maps of one image of (height, width) `size`."""
    scores = score_map(logits, convention.epsilon)
    pixels, valid = strongest(scores, keypoint_mask(scores, convention, size), count)
    keypoints = pixels.astype(scores.dtype)
    cells = cell_from_pixel(keypoints, convention.sampling, (coarse.shape[0], coarse.shape[1]), size)
    return Detections(
        keypoints=keypoints,
        scores=scores[pixels[:, 1], pixels[:, 0]],
        descriptors=read_descriptors(coarse, cells),
        scale=jnp.ones_like(scores, shape=len(pixels)),
        valid=valid,
    )


def superpoint(arrays: Mapping[str, np.ndarray] | None = None, *, rngs: nnx.Rngs) -> SuperPoint:
    """The network, v6 where the arrays say so."""
    return SuperPoint(affine=arrays is not None and "layer1a.gain" in arrays, rngs=rngs)


def recognise_v1(state: Mapping[str, np.ndarray]) -> bool:
    """Whether these are the keys of superpoint_v1.pth."""
    return {"conv1a.weight", "convPb.weight", "convDb.weight"} <= state.keys()


def recognise_v6(state: Mapping[str, np.ndarray]) -> bool:
    """Whether these are the keys of superpoint_v6_from_tf.pth."""
    return {"backbone.0.0.conv.weight", "backbone.0.0.bn.weight", "detector.1.conv.weight"} <= state.keys()


def convert_v1(state: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Magic Leap's keys and layouts to ours.

    Raises:
      ValueError: a key that is not one of them.
    """
    names = {f"conv{name}": f"layer{name}.conv" for name in (*ENCODER, "Pa", "Da")}
    names |= {f"conv{name}": f"conv{name}" for name in ("Pb", "Db")}
    found = {}
    for key, array in state.items():
        name, _, part = key.rpartition(".")
        if name not in names or part not in ("weight", "bias"):
            raise ValueError(f"unexpected key {key!r} in the checkpoint")
        found[f"{names[name]}.{'kernel' if part == 'weight' else part}"] = kernel_from_torch(array)
    return found


def convert_v6(state: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The keys and layouts of v6 to ours; batch normalisation becomes a gain and a shift, or part of a 1x1 convolution.

    Raises:
      ValueError: a key is missing, or is not one of them.
    """
    names = {f"backbone.{int(name[0]) - 1}.{'ab'.index(name[1])}": f"layer{name}" for name in ENCODER}
    for module, head in (("detector", "P"), ("descriptor", "D")):
        names |= {f"{module}.0": f"layer{head}a", f"{module}.1": f"conv{head}b"}
    parts = ("conv.weight", "conv.bias", "bn.weight", "bn.bias", "bn.running_mean", "bn.running_var")
    known = {f"{theirs}.{part}" for theirs in names for part in (*parts, "bn.num_batches_tracked")}
    if unknown := [key for key in state if key not in known]:
        raise ValueError(f"unexpected key {unknown[0]!r} in the checkpoint")
    found: dict[str, np.ndarray] = {}
    for theirs, ours in names.items():
        missing = [f"{theirs}.{part}" for part in parts if f"{theirs}.{part}" not in state]
        if missing:
            raise ValueError(f"key {missing[0]!r} is missing in the checkpoint")
        weight, bias, gamma, beta, mean, var = (np.asarray(state[f"{theirs}.{part}"]) for part in parts)
        kernel = kernel_from_torch(weight)
        gain = gamma / np.sqrt(var.astype(np.float64) + EPSILON_V6)
        shift = beta - mean * gain
        if ours.startswith("layer"):
            arrays = {"conv.kernel": kernel, "conv.bias": bias, "gain": gain, "shift": shift}
        else:
            arrays = {"kernel": kernel * gain, "bias": bias * gain + shift}
        found |= {f"{ours}.{part}": array.astype(np.float32) for part, array in arrays.items()}
    return found
