"""ResNet-50 (He et al. 2016, torchvision's variant: the stride is on the 3x3 convolution), with torchvision's weights.

RGB in [0, 1], NHWC; the network subtracts ImageNet's mean and divides by its deviation. Batch normalisation uses its
stored statistics, in training too: single images and small batches have none worth the name.
"""

from collections.abc import Mapping, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Float

from ebjax.models.layers import Buffer, Precision, conv, imagenet, max_pool, relu
from ebjax.models.weights import flat_arrays, kernel_from_torch, load_into

BLOCKS = (3, 4, 6, 3)
EPSILON = 1e-5


class BatchNorm(nnx.Module):
    """y = (x - mean) / sqrt(var + 1e-5) * scale + bias, with the stored mean and variance."""

    def __init__(self, channels: int):
        self.scale = nnx.Param(jnp.ones(channels, jnp.float32))
        self.bias = nnx.Param(jnp.zeros(channels, jnp.float32))
        self.mean = Buffer(jnp.zeros(channels, jnp.float32))
        self.var = Buffer(jnp.ones(channels, jnp.float32))

    def __call__(self, x: Float[Array, "B H W C"]) -> Float[Array, "B H W C"]:
        """Normalises."""
        return _batch_norm(x, self.scale[...], self.bias[...], self.mean[...], self.var[...])


@jax.jit
def _batch_norm(x, scale, bias, mean, var):
    gain = scale / jnp.sqrt(var + EPSILON)
    shift = bias - mean * gain
    return x * gain[None, None, None, :] + shift[None, None, None, :]


class Bottleneck(nnx.Module):
    """relu(x' + conv3(relu(conv2(relu(conv1(x)))))), where x' is x or, at the start of a stage, its projection."""

    def __init__(
        self,
        channels: int,
        width: int,
        *,
        stride: int,
        project: bool,
        folded: bool,
        precision: Precision,
        rngs: nnx.Rngs,
    ):
        layer = partial(conv, bias=folded, precision=precision, rngs=rngs)
        self.conv1 = layer(channels, width, 1)
        self.conv2 = layer(width, width, 3, stride=stride)
        self.conv3 = layer(width, 4 * width, 1)
        self.projection = layer(channels, 4 * width, 1, stride=stride) if project else None
        self.folded = folded
        if not folded:
            self.bn1, self.bn2, self.bn3 = BatchNorm(width), BatchNorm(width), BatchNorm(4 * width)
            self.projection_bn = BatchNorm(4 * width) if project else None

    def __call__(self, x: Float[Array, "B H W I"]) -> Float[Array, "B h w O"]:
        """One block."""
        y = relu(self._normal("bn1", self.conv1(x)))
        y = relu(self._normal("bn2", self.conv2(y)))
        y = self._normal("bn3", self.conv3(y))
        if self.projection is not None:
            x = self._normal("projection_bn", self.projection(x))
        return relu(x + y)

    def _normal(self, name: str, x: Float[Array, "B H W C"]) -> Float[Array, "B H W C"]:
        return x if self.folded else getattr(self, name)(x)


class ResNet50(nnx.Module):
    """H x W x 3 -> H/32 x W/32 x 2048.

    Args:
      folded: batch normalisation is part of the convolutions; `fold` makes such weights.
      precision: of the products; "highest" is float32, also on a GPU.
    """

    LAYERS = ("conv1", "relu1", "maxpool", "layer1", "layer2", "layer3", "layer4", "gap", "logits")

    def __init__(self, *, folded: bool = False, precision: Precision = "highest", rngs: nnx.Rngs):
        self.folded = folded
        self.conv1 = conv(3, 64, 7, stride=2, bias=folded, precision=precision, rngs=rngs)
        if not folded:
            self.bn1 = BatchNorm(64)
        channels = 64
        for stage, count in enumerate(BLOCKS, 1):
            width, blocks = 32 * 2**stage, []
            for n in range(count):
                stride = 2 if n == 0 and stage > 1 else 1
                blocks.append(
                    Bottleneck(
                        channels, width, stride=stride, project=n == 0, folded=folded, precision=precision, rngs=rngs
                    )
                )
                channels = 4 * width
            setattr(self, f"layer{stage}", nnx.List(blocks))
        self.fc = conv(2048, 1000, 1, precision=precision, rngs=rngs)

    def __call__(self, images: Float[Array, "B H W 3"], layer: str = "layer4") -> Float[Array, "B *n C"]:
        """The output of one layer.

        Args:
          images: RGB in [0, 1].
          layer: conv1 (before normalisation), relu1, maxpool, layer1 to layer4, gap (mean over the map) or logits.

        Raises:
          ValueError: there is no such layer.
        """
        return self.taps(imagenet(images), (layer,))[layer]

    def taps(self, x: Float[Array, "B H W 3"], names: Sequence[str]) -> dict[str, Float[Array, "B *n C"]]:
        """The outputs of the named layers of a normalised image; nothing after the last of them is computed."""
        if unknown := set(names) - set(self.LAYERS):
            raise ValueError(f"no layer {sorted(unknown)[0]!r}; there are {', '.join(self.LAYERS)}")
        found = {}
        for name in self.LAYERS[: 1 + max(map(self.LAYERS.index, names))]:
            x = self._apply(name, x)
            if name in names:
                found[name] = x
        return found

    def _apply(self, name: str, x: Float[Array, "B *n C"]) -> Float[Array, "B *m D"]:
        if name == "conv1":
            return self.conv1(x)
        if name == "relu1":
            return relu(x if self.folded else self.bn1(x))
        if name == "maxpool":
            return max_pool(x, 3, 2, 1)
        if name == "gap":
            return jnp.mean(x, (1, 2))
        if name == "logits":
            return self.fc(x[:, None, None, :])[:, 0, 0]
        for block in getattr(self, name):
            x = block(x)
        return x


def resnet50(arrays: Mapping[str, np.ndarray] | None = None, *, rngs: nnx.Rngs) -> ResNet50:
    """ResNet-50; folded when the arrays are."""
    return ResNet50(folded=arrays is not None and "conv1.bias" in arrays, rngs=rngs)


def fold(model: ResNet50) -> ResNet50:
    """The same network with each batch normalisation inside its convolution: faster, to rounding equal."""
    arrays = {key: np.asarray(array, np.float64) for key, array in flat_arrays(model).items()}
    folded = {key: array for key, array in arrays.items() if key.startswith("fc.")}
    for key in [key for key in arrays if key.endswith(".kernel") and key not in folded]:
        name = key.removesuffix(".kernel")
        norm = f"{name}_bn" if name.endswith("projection") else "bn".join(name.rsplit("conv", 1))
        gain = arrays[f"{norm}.scale"] / np.sqrt(arrays[f"{norm}.var"] + EPSILON)
        folded[key] = arrays[key] * gain
        folded[f"{name}.bias"] = arrays[f"{norm}.bias"] - arrays[f"{norm}.mean"] * gain
    result = nnx.eval_shape(lambda: ResNet50(folded=True, precision=model.conv1.precision, rngs=nnx.Rngs(0)))
    load_into(result, folded)
    return result


def recognise(state: Mapping[str, np.ndarray]) -> bool:
    """Whether the blocks are those of ResNet-50: 3, 4, 6 and 3 of them, with three convolutions each."""
    blocks = {tuple(key.split(".")[:2]) for key in state if key.startswith("layer") and ".conv3." in key}
    return blocks == {(f"layer{stage}", str(n)) for stage, count in enumerate(BLOCKS, 1) for n in range(count)}


def convert(state: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """From torchvision's ResNet-50, with or without `num_batches_tracked`, in any order."""
    parts = {"running_mean": "mean", "running_var": "var"}
    found = {}
    for key, array in state.items():
        name, _, part = key.rpartition(".")
        if part == "num_batches_tracked":
            continue
        name = name.replace("downsample.0", "projection").replace("downsample.1", "projection_bn")
        norm = "bn" in name.rsplit(".", 1)[-1]
        part = parts.get(part) or {"weight": "scale" if norm else "kernel"}.get(part, part)
        array = kernel_from_torch(array)
        found[f"{name}.{part}"] = array[None, None] if name == "fc" and array.ndim == 2 else array
    return found
