import jax
import jax.numpy as jnp
import pytest
from jax import lax

from ebjax.models.trainable import convolve


@pytest.mark.parametrize(("size", "stride", "padding"), [(3, 1, 1), (4, 2, 1), (6, 2, 2), (1, 1, 0)])
def test_values_and_gradients_are_those_of_xla(size, stride, padding):
    x_key, kernel_key, pull_key = jax.random.split(jax.random.key(0), 3)
    x = jax.random.normal(x_key, (2, 12, 8, 3))
    kernel = jax.random.normal(kernel_key, (size, size, 3, 5))

    def plain(x, kernel):
        numbers = ("NHWC", "HWIO", "NHWC")
        return lax.conv_general_dilated(x, kernel, (stride,) * 2, ((padding,) * 2,) * 2, dimension_numbers=numbers)

    expected, pull_plain = jax.vjp(plain, x, kernel)
    found, pull = jax.vjp(lambda x, kernel: convolve(x, kernel, stride, padding), x, kernel)
    assert jnp.allclose(found, expected, atol=1e-12)
    cotangent = jax.random.normal(pull_key, expected.shape)
    for ours, theirs in zip(pull(cotangent), pull_plain(cotangent), strict=True):
        assert jnp.allclose(ours, theirs, atol=1e-11)
