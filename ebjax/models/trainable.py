"""A convolution that also trains fast on a CPU: there XLA's gradient of the weights takes 2 to 10 times as long."""

from functools import partial

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float


@partial(jax.custom_vjp, nondiff_argnums=(2, 3))
def convolve(
    x: Float[Array, "B H W I"], kernel: Float[Array, "k k I O"], stride: int, padding: int
) -> Float[Array, "B h w O"]:
    """Zero padding; reverse-mode derivatives only."""
    return _plain(stride, padding, x, kernel)


def _plain(stride, padding, x, kernel):
    strides, pads = (stride, stride), ((padding, padding),) * 2
    return lax.conv_general_dilated(x, kernel, strides, pads, dimension_numbers=("NHWC", "HWIO", "NHWC"))


def _forward(x, kernel, stride, padding):
    return _plain(stride, padding, x, kernel), (x, kernel)


def _backward(stride, padding, saved, pull):
    x, kernel = saved
    (to_x,) = jax.vjp(lambda x: _plain(stride, padding, x, kernel), x)[1](pull)
    by_platform = partial(lax.platform_dependent, default=partial(_by_xla, stride, padding))
    return to_x, by_platform(x, kernel, pull, cpu=partial(_by_products, stride, padding))


def _by_xla(stride, padding, x, kernel, pull):
    return jax.vjp(partial(_plain, stride, padding, x), kernel)[1](pull)[0]


def _by_products(stride, padding, x, kernel, pull):
    """Image by image, one product of what is pulled back with all patches side by side."""
    size, _, channels_in, channels_out = kernel.shape
    reach = [stride * (n - 1) + 1 for n in pull.shape[1:3]]

    def add(total, image):
        padded = jnp.pad(image[0], ((padding, padding), (padding, padding), (0, 0)))
        taps = [
            lax.slice(padded, (i, j, 0), (i + reach[0], j + reach[1], channels_in), (stride, stride, 1))
            for i in range(size)
            for j in range(size)
        ]
        patches = jnp.concatenate(taps, -1).reshape(-1, size * size * channels_in)
        return total + image[1].reshape(-1, channels_out).T @ patches, None

    start = jnp.zeros((channels_out, size * size * channels_in), kernel.dtype)
    total, _ = lax.scan(add, start, (x, pull))
    return total.T.reshape(kernel.shape)


convolve.defvjp(_forward, _backward)
