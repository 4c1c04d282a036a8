"""ALIKED (Zhao et al., IEEE Trans. Instrum. Meas. 2023): ALIKE's keypoints, described at places the network chooses.

RGB in [0, 1] to a score and a feature for every pixel; a descriptor is read around a keypoint at M places of its own.

    scores, features = network(rgb)                 N H W, N H W D
    found = detect(network, rgb[0], threshold=0.2)  keypoints, scores, descriptors

Where the published code differs: it takes the mean score for threshold where nothing exceeds the given one (here
nothing is found then).
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Float

from ebjax.geometry.warp import sample_bilinear
from ebjax.models.alike import convert_blocks
from ebjax.models.checkpoint import taking
from ebjax.models.deform import DeformConv
from ebjax.models.detect import Detections
from ebjax.models.dkd import find_keypoints
from ebjax.models.layers import Precision, avg_pool, conv, normalise
from ebjax.models.resize import resize
from ebjax.models.weights import kernel_from_torch

CELL = 32
PATCH = 3
VARIANTS = {
    "aliked-t16": ((8, 16, 32, 64), 64, 16),
    "aliked-n16": ((16, 32, 64, 128), 128, 16),
    "aliked-n32": ((16, 32, 64, 128), 128, 32),
}
"""Channels of the blocks, length of a descriptor, and places that it is read at; n16rot is an n16."""
DEFORMED = (3, 4)
SCORE = ((8, 1), (4, 3), (4, 3), (1, 3))
"""Channels and size of the convolutions that give the score."""


class Block(nnx.Module):
    """selu(conv2(selu(conv1(x)))), where a residual block adds a projection of x before the last SELU."""

    def __init__(
        self,
        channels_in: int,
        channels_out: int,
        *,
        deformed: bool,
        residual: bool,
        precision: Precision,
        rngs: nnx.Rngs,
    ):
        options: dict[str, Any] = {"precision": precision, "rngs": rngs}
        make: Callable[..., nnx.Module] = DeformConv if deformed else conv
        self.conv1: Any = make(channels_in, channels_out, **options)
        self.conv2: Any = make(channels_out, channels_out, **options)
        self.projection = conv(channels_in, channels_out, 1, **options) if residual else None

    def __call__(self, x: Float[Array, "N H W I"]) -> Float[Array, "N H W O"]:
        """One block."""
        y = self.conv2(nnx.selu(self.conv1(x)))
        return nnx.selu(y if self.projection is None else y + self.projection(x))


class ALIKED(nnx.Module):
    """N x H x W x 3 to scores and features of every pixel; any size, its border repeated to multiples of 32 inside.

    Args:
      channels: of the four blocks.
      dimension: of a descriptor.
      places: that a descriptor is read at.
      precision: of the products; "highest" is float32, also on a GPU.
    """

    def __init__(
        self,
        channels: Sequence[int] = VARIANTS["aliked-n16"][0],
        dimension: int = VARIANTS["aliked-n16"][1],
        places: int = VARIANTS["aliked-n16"][2],
        *,
        precision: Precision = "highest",
        rngs: nnx.Rngs,
    ):
        options: dict[str, Any] = {"precision": precision, "rngs": rngs}
        before = 3
        for n, width in enumerate(channels, 1):
            setattr(self, f"block{n}", Block(before, width, deformed=n in DEFORMED, residual=n > 1, **options))
            setattr(self, f"gather{n}", conv(width, dimension // 4, 1, bias=False, **options))
            before = width
        before = dimension
        for n, (width, size) in enumerate(SCORE, 1):
            setattr(self, f"score{n}", conv(before, width, size, bias=False, **options))
            before = width
        self.offset1 = conv(dimension, 2 * places, PATCH, padding=0, **options)
        self.offset2 = conv(2 * places, 2 * places, 1, **options)
        self.read = conv(dimension, dimension, 1, bias=False, **options)
        initial = nnx.initializers.orthogonal()
        self.merge = nnx.Param(initial(rngs.params(), (places, dimension, dimension), jnp.float32))
        self.precision: Precision = precision

    def __call__(self, images: Float[Array, "N H W 3"]) -> tuple[Float[Array, "N H W"], Float[Array, "N H W D"]]:
        """Scores in (0, 1) and unit features."""
        height, width = images.shape[1:3]
        (top, below), (left, right) = (_around(length) for length in (height, width))
        x = jnp.pad(images, ((0, 0), (top, below), (left, right), (0, 0)), mode="edge")
        size, gathered = (x.shape[1], x.shape[2]), []
        for n, pool in enumerate((1, 2, 4, 4), 1):
            x = getattr(self, f"block{n}")(x if pool == 1 else avg_pool(x, pool))
            gathered.append(resize(nnx.selu(getattr(self, f"gather{n}")(x)), size))
        features = score = jnp.concatenate(gathered, -1)
        for n in range(1, len(SCORE) + 1):
            score = getattr(self, f"score{n}")(score if n == 1 else nnx.selu(score))
        seen = (slice(None), slice(top, top + height), slice(left, left + width))
        return nnx.sigmoid(score[seen][..., 0]), normalise(features[seen])

    def describe(self, features: Float[Array, "H W D"], keypoints: Float[Array, "K 2"]) -> Float[Array, "K D"]:
        """Unit descriptors of keypoints (x, y) px, read at places that the features around a keypoint ask for."""
        height, width = features.shape[:2]
        last = jnp.asarray([width - 1 - PATCH, height - 1 - PATCH])
        corners = jnp.clip(keypoints.astype(jnp.int32) - PATCH // 2, 0, last[None, :])
        steps = jnp.arange(PATCH)
        rows, columns = corners[:, 1, None] + steps[None, :], corners[:, 0, None] + steps[None, :]
        patches = features[rows[:, :, None], columns[:, None, :]]
        most = max(height, width) / 4
        asked = jnp.clip(self.offset2(nnx.selu(self.offset1(patches)))[:, 0, 0], -most, most)
        # All x come first, then all y.
        places = keypoints[:, None, :] + asked.reshape(len(keypoints), 2, -1).transpose(0, 2, 1)
        read = nnx.selu(self.read(sample_bilinear(features, places)[None]))[0]
        merge = self.merge[...].astype(read.dtype)
        return normalise(jnp.einsum("kpc,pcd->kd", read, merge, precision=self.precision))


def _around(length: int) -> tuple[int, int]:
    """What is put before and behind a side to make it a multiple of 32."""
    more = -length % CELL
    return more // 2, more - more // 2


def detect(
    network: ALIKED,
    image: Float[Array, "H W 3"],
    *,
    count: int = 5000,
    threshold: float = 0.2,
) -> Detections:
    """Detects and describes one image.

    Args:
      network: any variant.
      image: RGB in [0, 1].
      count: of rows, the keypoints of highest score (the published `n_limit`, and with threshold 0 its `top_k`); above
        H W every one.
      threshold: lowest score, before the sub-pixel step.
    """
    scores, features = network(image[None])
    keypoints, best, valid = find_keypoints(scores[0], count=count, threshold=threshold)
    return Detections(
        keypoints=keypoints,
        scores=best,
        descriptors=network.describe(features[0], keypoints),
        scale=jnp.ones_like(scores, shape=len(keypoints)),
        valid=valid,
    )


def aliked(arrays: Mapping[str, np.ndarray] | None = None, *, rngs: nnx.Rngs) -> ALIKED:
    """The variant the arrays are of; ALIKED-n16 without."""
    if arrays is None:
        return ALIKED(rngs=rngs)
    try:
        channels = [arrays[f"block{n}.conv2.kernel"].shape[3] for n in range(1, 5)]
        places, dimension, _ = arrays["merge"].shape
    except (KeyError, IndexError, ValueError) as error:
        raise ValueError(f"these are not the weights of ALIKED: {error}") from None
    return ALIKED(channels, dimension, places, rngs=rngs)


def recognise(state: Mapping[str, np.ndarray]) -> bool:
    """Whether these are the keys of aliked-n16rot.pth, -n16, -n32 or -t16."""
    return {"block4.conv1.offset_conv.weight", "desc_head.agg_weights", "score_head.6.weight"} <= state.keys()


def convert(state: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The published keys and layouts to ours; batch normalisation becomes part of its convolution.

    Raises:
      ValueError: a key is missing, or is not one of them.
    """
    with taking(state) as take:
        found = convert_blocks(take, DEFORMED)
        for name in (f"block{n}.conv{k}" for n in DEFORMED for k in (1, 2)):
            found[f"{name}.offset.kernel"] = kernel_from_torch(take(f"{name}.offset_conv.weight"))
            found[f"{name}.offset.bias"] = take(f"{name}.offset_conv.bias")
        for n in range(len(SCORE)):
            found[f"score{n + 1}.kernel"] = kernel_from_torch(take(f"score_head.{2 * n}.weight"))
        for n in (1, 2):
            found[f"offset{n}.kernel"] = kernel_from_torch(take(f"desc_head.offset_conv.{2 * n - 2}.weight"))
            found[f"offset{n}.bias"] = take(f"desc_head.offset_conv.{2 * n - 2}.bias")
        found["read.kernel"] = kernel_from_torch(take("desc_head.sf_conv.weight"))
        found["merge"] = take("desc_head.agg_weights")
    return found
