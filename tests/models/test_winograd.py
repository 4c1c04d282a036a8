import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.models.winograd import SMALL, winograd_conv, winograd_kernel


@pytest.mark.parametrize("size, dtype", [((1, 5), jnp.float64), ((70, 66), jnp.float32)])
def test_is_the_convolution_with_a_zero_border(size, dtype):
    rng = np.random.default_rng(0)
    x = jnp.asarray(rng.normal(size=(2, *size, 3)), dtype)
    kernel = jnp.asarray(rng.normal(size=(3, 3, 3, 4)), dtype)
    want = jax.lax.conv_general_dilated(x, kernel, (1, 1), "SAME", dimension_numbers=("NHWC", "HWIO", "NHWC"))
    got = jax.jit(winograd_conv)(x, winograd_kernel(kernel))
    assert got.dtype == dtype
    np.testing.assert_allclose(got, want, atol=1e-4 if dtype == jnp.float32 else 1e-12)


def test_both_sizes_of_product_are_tried():
    assert 2 * 18 * 17 > SMALL > 2 * 1 * 2
