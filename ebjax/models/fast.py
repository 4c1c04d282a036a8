"""Faster forms of a network for inference on a CPU, where that pays (how much: `python -m ebjax.bench networks`).

fast = accelerate(network)                 3x3 convolutions by Winograd: float32, equal to rounding
fast = accelerate(network, "bfloat16")     and products of many channels in bfloat16 with float32 sums
"""

from typing import Any, Literal

import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Float

from ebjax.models.layers import Conv
from ebjax.models.winograd import winograd_conv, winograd_kernel

Arithmetic = Literal["exact", "winograd", "bfloat16"]
MANY = 256


class WinogradConv(nnx.Module):
    """A 3x3 `Conv` of stride 1, its kernel transformed once."""

    def __init__(self, conv: Conv):
        self.kernel = nnx.Param(winograd_kernel(conv.kernel[...]))
        self.bias = None if conv.bias is None else nnx.Param(conv.bias[...])
        self.dilation, self.precision = conv.dilation, conv.precision

    def __call__(self, x: Float[Array, "B H W I"]) -> Float[Array, "B H W O"]:
        """The convolution; a dilated one acts on every d-th row and column alone."""
        batch, height, width, channels = x.shape
        d = self.dilation
        if d > 1:
            x = jnp.pad(x, ((0, 0), (0, -height % d), (0, -width % d), (0, 0)))
            x = x.reshape(batch, x.shape[1] // d, d, x.shape[2] // d, d, channels).transpose(2, 4, 0, 1, 3, 5)
            phases, inner = x.shape[:3], x.shape[3:5]
            x = x.reshape(-1, *inner, channels)
        y = winograd_conv(x, self.kernel[...], self.precision)
        if d > 1:
            y = y.reshape(*phases, *inner, -1).transpose(2, 3, 0, 4, 1, 5)
            y = y.reshape(batch, inner[0] * d, inner[1] * d, -1)[:, :height, :width]
        return y if self.bias is None else y + self.bias[...][None, None, None, :]


class HalfConv(nnx.Module):
    """A `Conv` as one product a kernel element, the factors in bfloat16 and the sums in the input's dtype."""

    def __init__(self, conv: Conv):
        self.kernel = nnx.Param(conv.kernel[...].astype(jnp.bfloat16))
        self.bias = None if conv.bias is None else nnx.Param(conv.bias[...])
        self.stride, self.dilation, self.padding = conv.stride, conv.dilation, conv.padding

    def __call__(self, x: Float[Array, "B H W I"]) -> Float[Array, "B h w O"]:
        """The convolution."""
        kernel, pad = self.kernel[...], (self.padding, self.padding)
        reach = [self.dilation * (n - 1) for n in kernel.shape[:2]]
        rows, columns = (n + 2 * self.padding - r for n, r in zip(x.shape[1:3], reach, strict=True))
        padded = jnp.pad(x.astype(kernel.dtype), ((0, 0), pad, pad, (0, 0)))
        y: Any = 0
        for i in range(kernel.shape[0]):
            for j in range(kernel.shape[1]):
                top, left = i * self.dilation, j * self.dilation
                part = padded[:, top : top + rows : self.stride, left : left + columns : self.stride]
                y = y + jnp.einsum("bhwi,io->bhwo", part, kernel[i, j], preferred_element_type=x.dtype)
        return y if self.bias is None else y + self.bias[...][None, None, None, :]


def accelerate(network: Any, arithmetic: Arithmetic = "winograd") -> Any:
    """A copy of a network that computes the convolutions for which it pays in a faster way.

    Args:
      network: of any kind; it is left alone.
      arithmetic: "winograd" or "bfloat16"; "exact" changes nothing.
    """
    network = nnx.clone(network)
    if arithmetic == "exact":
        return network
    for _, module in list(nnx.iter_modules(network)):
        for name, child in list(vars(module).items()):
            if isinstance(child, Conv) and (faster := _faster(child, arithmetic)) is not None:
                setattr(module, name, faster)
    return network


def _faster(conv: Conv, arithmetic: Arithmetic) -> nnx.Module | None:
    height, width, channels_in, channels_out = conv.kernel.shape
    if arithmetic == "bfloat16" and min(channels_in, channels_out) >= MANY:
        return HalfConv(conv)
    plain = (height, width) == (3, 3) and conv.stride == 1 and conv.padding == conv.dilation
    return WinogradConv(conv) if plain and channels_in >= 64 and channels_out >= 128 else None
