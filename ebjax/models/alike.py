"""ALIKE (Zhao et al., IEEE Trans. Multimedia 2022): keypoints by a differentiable soft-argmax, dense light descriptors.

RGB in [0, 1] to a score and a descriptor for every pixel. Four blocks at 1, 1/2, 1/8 and 1/32 of the size are brought
back to the full size, put side by side and read by a 1x1 head.

    scores, descriptors = network(rgb)              N H W, N H W D
    found = detect(network, rgb[0], threshold=0.2)  keypoints, scores, descriptors

Where the published code differs: it takes the mean score for threshold where nothing exceeds the given one (here
nothing is found then), and without sub-pixel places it reads 10 to 48 % of the descriptors one pixel up or left, by
rounding to [-1, 1] and back (here never).
"""

from collections.abc import Collection, Mapping, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Float

from ebjax.models.checkpoint import Take, taking
from ebjax.models.detect import Detections, read_descriptors
from ebjax.models.dkd import RADIUS, find_keypoints
from ebjax.models.layers import Precision, conv, max_pool, normalise, relu
from ebjax.models.resize import resize
from ebjax.models.weights import folded_norm, kernel_from_torch

CELL = 32
EPSILON = 1e-5
VARIANTS = {
    "alike-t": ((8, 16, 32, 64), 64, False),
    "alike-s": ((8, 16, 48, 96), 96, False),
    "alike-n": ((16, 32, 64, 128), 128, False),
    "alike-l": ((32, 64, 128, 128), 128, True),
}
"""Channels of the blocks, length of a descriptor, and whether the head has two layers."""


class Block(nnx.Module):
    """relu(conv2(relu(conv1(x)))), where a residual block adds a projection of x before the last ReLU."""

    def __init__(self, channels_in: int, channels_out: int, *, residual: bool, precision: Precision, rngs: nnx.Rngs):
        options: dict[str, Any] = {"precision": precision, "rngs": rngs}
        self.conv1 = conv(channels_in, channels_out, **options)
        self.conv2 = conv(channels_out, channels_out, **options)
        self.projection = conv(channels_in, channels_out, 1, **options) if residual else None

    def __call__(self, x: Float[Array, "N H W I"]) -> Float[Array, "N H W O"]:
        """One block."""
        y = self.conv2(relu(self.conv1(x)))
        return relu(y if self.projection is None else y + self.projection(x))


class ALIKE(nnx.Module):
    """N x H x W x 3 to scores and descriptors of every pixel; any size, padded with zeros to multiples of 32 inside.

    Args:
      channels: of the four blocks.
      dimension: of a descriptor.
      two_layers: whether the head has two.
      precision: of the products; "highest" is float32, also on a GPU.
    """

    def __init__(
        self,
        channels: Sequence[int] = VARIANTS["alike-n"][0],
        dimension: int = VARIANTS["alike-n"][1],
        two_layers: bool = False,
        *,
        precision: Precision = "highest",
        rngs: nnx.Rngs,
    ):
        options: dict[str, Any] = {"precision": precision, "rngs": rngs}
        before = 3
        for n, width in enumerate(channels, 1):
            setattr(self, f"block{n}", Block(before, width, residual=n > 1, **options))
            setattr(self, f"gather{n}", conv(width, dimension // 4, 1, bias=False, **options))
            before = width
        self.head1 = conv(dimension, dimension, 1, bias=False, **options) if two_layers else None
        self.head2 = conv(dimension, dimension + 1, 1, bias=False, **options)

    def __call__(self, images: Float[Array, "N H W 3"]) -> tuple[Float[Array, "N H W"], Float[Array, "N H W D"]]:
        """Scores in (0, 1) and unit descriptors."""
        height, width = images.shape[1:3]
        head = self.head(self.blocks(images))[:, :height, :width]
        return nnx.sigmoid(head[..., -1]), normalise(head[..., :-1])

    def blocks(self, images: Float[Array, "N H W 3"]) -> list[Float[Array, "N _ _ _"]]:
        """The maps of the four blocks, of the padded image."""
        below = [-length % CELL for length in images.shape[1:3]]
        x = jnp.pad(images, ((0, 0), (0, below[0]), (0, below[1]), (0, 0)))
        maps = []
        for n, pool in enumerate((1, 2, 4, 4), 1):
            x = getattr(self, f"block{n}")(max_pool(x, pool))
            maps.append(x)
        return maps

    def head(self, maps: Sequence[Float[Array, "N _ _ _"]]) -> Float[Array, "N H W E"]:
        """Descriptors before they are made unit, and the logit of the score as the last channel."""
        size = (maps[0].shape[1], maps[0].shape[2])
        gathered = [relu(getattr(self, f"gather{n}")(x)) for n, x in enumerate(maps, 1)]
        x = jnp.concatenate([resize(x, size) for x in gathered], -1)
        return self.head2(x if self.head1 is None else relu(self.head1(x)))


def detect(
    network: ALIKE,
    image: Float[Array, "H W 3"],
    *,
    count: int = 5000,
    threshold: float = 0.2,
    sub_pixel: bool = True,
) -> Detections:
    """Detects and describes one image.

    Args:
      network: any variant.
      image: RGB in [0, 1].
      count: of rows, the keypoints of highest score (the published `n_limit`, and with threshold 0 its `top_k`); above
        H W every one.
      threshold: lowest score, before the sub-pixel step.
      sub_pixel: move keypoints to the mean of their 5x5 window under softmax(score / 0.1): differentiable.
    """
    scores, descriptors = network(image[None])
    return detect_maps(scores[0], descriptors[0], count=count, threshold=threshold, sub_pixel=sub_pixel)


@partial(jax.jit, static_argnames=("count", "sub_pixel"))
def detect_maps(
    scores: Float[Array, "H W"],
    descriptors: Float[Array, "H W D"],
    *,
    count: int,
    threshold: float | Float[Array, ""],
    sub_pixel: bool,
) -> Detections:
    """`detect`, from the maps of one image."""
    # The published code leaves out one row and one column more at the top and left.
    keypoints, best, valid = find_keypoints(
        scores, count=count, threshold=threshold, border=RADIUS + 1, sub_pixel=sub_pixel
    )
    return Detections(
        keypoints=keypoints,
        scores=best,
        descriptors=read_descriptors(descriptors, keypoints),
        scale=jnp.ones_like(scores, shape=len(keypoints)),
        valid=valid,
    )


def alike(arrays: Mapping[str, np.ndarray] | None = None, *, rngs: nnx.Rngs) -> ALIKE:
    """The variant the arrays are of; ALIKE-n without."""
    if arrays is None:
        return ALIKE(rngs=rngs)
    try:
        channels = [arrays[f"block{n}.conv2.kernel"].shape[3] for n in range(1, 5)]
        return ALIKE(channels, arrays["head2.kernel"].shape[2], "head1.kernel" in arrays, rngs=rngs)
    except (KeyError, IndexError) as error:
        raise ValueError(f"these are not the weights of ALIKE: {error}") from None


def recognise(state: Mapping[str, np.ndarray]) -> bool:
    """Whether these are the keys of alike-t.pth, -s, -n or -l."""
    return {"block1.conv1.weight", "block4.downsample.weight", "convhead2.weight"} <= state.keys()


def convert(state: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The published keys and layouts to ours; batch normalisation becomes part of its convolution.

    Raises:
      ValueError: a key is missing, or is not one of them.
    """
    with taking(state) as take:
        found = convert_blocks(take)
        if "convhead1.weight" in state:
            found["head1.kernel"] = kernel_from_torch(take("convhead1.weight"))
        found["head2.kernel"] = kernel_from_torch(take("convhead2.weight"))
    return found


def convert_blocks(take: Take, deformed: Collection[int] = ()) -> dict[str, np.ndarray]:
    """The four blocks and what is gathered of them, which ALIKED has as well; `deformed` are its deformable blocks."""
    found = {}
    for n in range(1, 5):
        found[f"gather{n}.kernel"] = kernel_from_torch(take(f"conv{n}.weight"))
        for k in (1, 2):
            name = f"block{n}.conv{k}"
            kernel = kernel_from_torch(take(f"{name}.regular_conv.weight" if n in deformed else f"{name}.weight"))
            scale, shift, mean, var = (
                take(f"block{n}.bn{k}.{part}") for part in ("weight", "bias", "running_mean", "running_var")
            )
            found |= folded_norm(name, kernel, mean, var, EPSILON, scale, shift)
        if n > 1:
            found[f"block{n}.projection.kernel"] = kernel_from_torch(take(f"block{n}.downsample.weight"))
            found[f"block{n}.projection.bias"] = take(f"block{n}.downsample.bias")
    return found
