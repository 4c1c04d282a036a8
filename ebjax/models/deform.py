"""Deformable convolution (Dai et al., ICCV 2017) as bilinear reads and a product: differentiable in all it is given."""

from typing import Any

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Float

from ebjax.geometry.warp import sample_bilinear
from ebjax.models.layers import Precision, conv

TAPS = 3


def deform_conv(
    x: Float[Array, "N H W I"],
    offsets: Float[Array, "N H W 9 2"],
    kernel: Float[Array, "3 3 I O"],
    bias: Float[Array, " O"],
    precision: Precision = "highest",
) -> Float[Array, "N H W O"]:
    """y(p) = bias + sum_k kernel_k x(p + k + offset_k(p)), for the 9 steps k of a 3 x 3 window, row by row.

    Args:
      x: zero outside; read bilinearly.
      offsets: (x, y) px.
      kernel: 3, 3, in, out.
      bias: out.
      precision: of the products.
    """
    height, width = x.shape[1:3]
    rows, columns = jnp.arange(height, dtype=x.dtype), jnp.arange(width, dtype=x.dtype)
    steps = jnp.arange(TAPS, dtype=x.dtype) - TAPS // 2
    window = jnp.stack(jnp.meshgrid(steps, steps), -1).reshape(-1, 2)
    pixels = jnp.stack(jnp.meshgrid(columns, rows), -1)
    points = pixels[None, :, :, None, :] + window[None, None, None, :, :] + offsets
    read = jax.vmap(sample_bilinear)(x, points)
    weights = kernel.reshape(-1, *kernel.shape[2:]).astype(read.dtype)
    return jnp.einsum("nhwki,kio->nhwo", read, weights, precision=precision) + bias[None, None, None, :]


class DeformConv(nnx.Module):
    """A 3 x 3 deformable convolution whose offsets another convolution finds; at most a quarter of the map's side.

    Attributes:
      kernel: 3, 3, in, out.
      bias: out.
      offset: gives (y, x) of the 9 steps, as torchvision orders them.
    """

    def __init__(self, channels_in: int, channels_out: int, *, precision: Precision = "highest", rngs: nnx.Rngs):
        initial: Any = nnx.initializers.orthogonal(2**0.5)
        self.kernel = nnx.Param(initial(rngs.params(), (TAPS, TAPS, channels_in, channels_out), jnp.float32))
        self.bias = nnx.Param(jnp.zeros(channels_out, jnp.float32))
        self.offset = conv(channels_in, 2 * TAPS**2, precision=precision, rngs=rngs)
        self.precision: Precision = precision

    def __call__(self, x: Float[Array, "N H W I"]) -> Float[Array, "N H W O"]:
        """The convolution."""
        most = max(x.shape[1:3]) / 4
        offsets = jnp.clip(self.offset(x), -most, most).reshape(*x.shape[:3], TAPS**2, 2)[..., ::-1]
        return deform_conv(x, offsets, self.kernel[...], self.bias[...], self.precision)
