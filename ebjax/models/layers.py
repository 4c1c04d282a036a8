"""What the networks are built of: convolutions, pools and the stack of VGG. NHWC, kernels HWIO as in `nnx.Conv`.

Padding and rounding are torch's, since that is what the published weights were trained with. Without weights every
kernel is orthogonal, from the seed of `rngs`: for shapes and equivariance, never for results.
"""

import re
from collections.abc import Sequence
from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
from flax import nnx
from jax import lax
from jaxtyping import Array, Float

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_DEVIATION = (0.229, 0.224, 0.225)
Precision = Literal["default", "high", "highest"]


class Buffer(nnx.Variable):
    """An array that belongs to the weights but is not trained: a mean, the statistics of a batch normalisation."""


class Conv(nnx.Module):
    """y = x * kernel + bias, zero padding; a 1x1 convolution is one dot.

    Attributes:
      kernel: height, width, in, out.
      bias: out, or None.
    """

    def __init__(
        self,
        channels_in: int,
        channels_out: int,
        size: int = 3,
        *,
        stride: int = 1,
        dilation: int = 1,
        padding: int | None = None,
        bias: bool = True,
        precision: Precision = "highest",
        rngs: nnx.Rngs,
    ):
        initial = nnx.initializers.orthogonal(2**0.5)
        self.kernel = nnx.Param(initial(rngs.params(), (size, size, channels_in, channels_out), jnp.float32))
        self.bias = nnx.Param(jnp.zeros(channels_out, jnp.float32)) if bias else None
        self.stride, self.dilation, self.precision = stride, dilation, precision
        self.padding = dilation * (size // 2) if padding is None else padding

    def __call__(self, x: Float[Array, "B H W I"]) -> Float[Array, "B h w O"]:
        """Computes in the wider of the dtypes of the input and the weights."""
        bias = None if self.bias is None else self.bias[...]
        return _convolve(x, self.kernel[...], bias, self.stride, self.dilation, self.padding, self.precision)


def conv(channels_in: int, channels_out: int, size: int = 3, *, rngs: nnx.Rngs, **options) -> Conv:
    """`Conv` that keeps the size of the map (over the stride) unless `padding` says otherwise."""
    return Conv(channels_in, channels_out, size, rngs=rngs, **options)


# Compiled one by one, layers are as fast outside jit as inside.
@partial(jax.jit, static_argnums=(3, 4, 5, 6))
def _convolve(x, kernel, bias, stride, dilation, padding, precision):
    dtype = jnp.result_type(x, kernel)
    x, kernel = x.astype(dtype), kernel.astype(dtype)
    if kernel.shape[:2] == (1, 1) and padding == 0:
        y = jnp.einsum("bhwi,io->bhwo", x[:, ::stride, ::stride], kernel[0, 0], precision=precision)
    else:
        y = lax.conv_general_dilated(
            x,
            kernel,
            (stride, stride),
            ((padding, padding),) * 2,
            rhs_dilation=(dilation, dilation),
            dimension_numbers=("NHWC", "HWIO", "NHWC"),
            precision=precision,
        )
    return y if bias is None else y + bias.astype(dtype)[None, None, None, :]


@partial(jax.jit, static_argnames=("size", "stride", "padding"))
def max_pool(
    x: Float[Array, "B H W C"], size: int = 2, stride: int | None = None, padding: int = 0
) -> Float[Array, "B h w C"]:
    """Maximum over size x size windows; what does not fill a window is left out, as in torch."""
    return nnx.max_pool(x, (size, size), (stride or size,) * 2, ((padding, padding),) * 2)


@partial(jax.jit, static_argnames=("size", "stride"))
def avg_pool(x: Float[Array, "B H W C"], size: int = 2, stride: int | None = None) -> Float[Array, "B h w C"]:
    """Mean over size x size windows, no padding."""
    return nnx.avg_pool(x, (size, size), (stride or size,) * 2, "VALID")


@jax.jit
def relu(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """max(x, 0)."""
    return jax.nn.relu(x)


@partial(jax.jit, static_argnames="axis")
def normalise(x: Float[Array, "*n"], axis: int = -1) -> Float[Array, "*n"]:
    """Unit length, x / max(|x|, 1e-12), along `axis`; zero stays zero, and its gradient is finite."""
    squared = jnp.sum(x * x, axis, keepdims=True)
    return x * lax.rsqrt(jnp.maximum(squared, 1e-24))


@jax.jit
def imagenet(images: Float[Array, "B H W 3"]) -> Float[Array, "B H W 3"]:
    """RGB in [0, 1] less ImageNet's mean, over its deviation: the input of torchvision's networks."""
    mean, deviation = (jnp.asarray(v, images.dtype) for v in (IMAGENET_MEAN, IMAGENET_DEVIATION))
    return (images - mean[None, None, None, :]) / deviation[None, None, None, :]


class Stack(nnx.Module):
    """The convolutional part of VGG (Simonyan and Zisserman 2015): stages of 3x3 convolutions with ReLU, then a pool.

    Layers are called conv{stage}_{n}, relu{stage}_{n} and pool{stage}; a convolution's name means its output before the
    ReLU. The convolutions are attributes of those names, so weights are called "conv1_1.kernel" and so on.

    Args:
      stages: convolutions in each stage; the widths are 64, 128, 256, 512, 512.
      pools: what ends each stage: "max" (2x2, stride 2), "avg" (2x2, stride 1) or "".
      dilations: of the convolutions of each stage; None is 1.
      precision: of the products; "highest" is float32, also on a GPU.
    """

    WIDTHS = (64, 128, 256, 512, 512)

    def __init__(
        self,
        stages: Sequence[int],
        *,
        pools: Sequence[str] | None = None,
        dilations: Sequence[int] | None = None,
        precision: Precision = "highest",
        rngs: nnx.Rngs,
    ):
        self.stages = tuple(stages)
        self.pools = ("max",) * len(self.stages) if pools is None else tuple(pools)
        dilations = (1,) * len(self.stages) if dilations is None else tuple(dilations)
        channels = 3
        for stage, (count, width, dilation) in enumerate(zip(stages, self.WIDTHS, dilations, strict=False), 1):
            for n in range(1, count + 1):
                layer = conv(channels, width, dilation=dilation, precision=precision, rngs=rngs)
                setattr(self, f"conv{stage}_{n}", layer)
                channels = width

    def layer_names(self) -> list[str]:
        """Every layer in order."""
        names = []
        for stage, (count, pool) in enumerate(zip(self.stages, self.pools, strict=True), 1):
            names += [f"{kind}{stage}_{n}" for n in range(1, count + 1) for kind in ("conv", "relu")]
            names += [f"pool{stage}"] if pool else []
        return names

    def taps(self, x: Float[Array, "B H W 3"], names: Sequence[str]) -> dict[str, Float[Array, "B h w C"]]:
        """The outputs of the named layers; nothing after the last of them is computed.

        Raises:
          ValueError: there is no such layer.
        """
        order = self.layer_names()
        if unknown := set(names) - set(order):
            raise ValueError(f"no layer {sorted(unknown)[0]!r}; there are {', '.join(order)}")
        found = {}
        for name in order[: 1 + max(map(order.index, names))]:
            x = self._apply(name, x)
            if name in names:
                found[name] = x
        return found

    def _apply(self, name: str, x: Float[Array, "B H W C"]) -> Float[Array, "B h w O"]:
        kind, stage = re.match(r"([a-z]+)(\d)", name).groups()  # type: ignore[union-attr]
        if kind == "conv":
            return getattr(self, name)(x)
        if kind == "relu":
            return relu(x)
        return max_pool(x) if self.pools[int(stage) - 1] == "max" else avg_pool(x, stride=1)
