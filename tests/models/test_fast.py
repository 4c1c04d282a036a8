import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

from ebjax.models.fast import HalfConv, WinogradConv, accelerate
from ebjax.models.layers import Conv, Stack
from ebjax.models.resnet import Bottleneck


@pytest.mark.parametrize("dilation", [1, 3])
def test_winograd_convolution_dilated_too(dilation):
    layer = Conv(3, 4, dilation=dilation, rngs=nnx.Rngs(0))
    layer.bias[...] = jnp.arange(4, dtype=jnp.float32)
    x = jnp.asarray(np.random.default_rng(0).normal(size=(2, 11, 14, 3)), jnp.float32)
    want = layer(x)
    np.testing.assert_allclose(jax.jit(WinogradConv(layer).__call__)(x), want, atol=1e-5 * float(jnp.abs(want).max()))


@pytest.mark.parametrize("options", [{"stride": 2}, {"dilation": 2}, {"size": 1, "stride": 2}])
def test_half_precision_convolution(options):
    layer = Conv(8, 4, rngs=nnx.Rngs(0), **options)
    x = jnp.asarray(np.random.default_rng(0).normal(size=(2, 9, 12, 8)), jnp.float32)
    want, got = layer(x), HalfConv(layer)(x)
    assert got.dtype == jnp.float32 and got.shape == want.shape
    np.testing.assert_allclose(got, want, atol=0.02 * float(jnp.abs(want).max()))
    rounded = Conv(8, 4, rngs=nnx.Rngs(0), **options)
    rounded.kernel[...] = layer.kernel[...].astype(jnp.bfloat16).astype(jnp.float32)
    exact = rounded(x.astype(jnp.bfloat16).astype(jnp.float32))
    np.testing.assert_allclose(got, exact, atol=1e-5)


@pytest.mark.parametrize("arithmetic, kinds", [("winograd", "WWCC"), ("bfloat16", "WHHC")])
def test_only_layers_for_which_it_pays(monkeypatch, arithmetic, kinds):
    monkeypatch.setattr("ebjax.models.fast.MANY", 128)
    stack = nnx.eval_shape(lambda: Stack((1, 2, 1), rngs=nnx.Rngs(0)))
    stack.conv3_1.stride = 2
    fast = nnx.eval_shape(lambda stack: accelerate(stack, arithmetic), stack)
    names = ("conv2_1", "conv2_2", "conv3_1", "conv1_1")
    letter = {WinogradConv: "W", HalfConv: "H", Conv: "C"}
    assert "".join(letter[type(getattr(fast, name))] for name in names) == kinds
    assert all(type(getattr(stack, name)) is Conv for name in names)


@pytest.mark.slow
def test_nested_networks_are_reached_and_give_the_same():
    class Network(nnx.Module):
        def __init__(self):
            options = {"stride": 1, "project": False, "folded": True, "precision": "highest", "rngs": nnx.Rngs(0)}
            self.blocks = nnx.List([Bottleneck(512, 128, **options)])

    network = Network()
    fast = accelerate(network)
    assert isinstance(fast.blocks[0].conv2, WinogradConv) and isinstance(network.blocks[0].conv2, Conv)
    x = jnp.asarray(np.random.default_rng(0).uniform(size=(1, 6, 5, 512)), jnp.float32)
    run = jax.jit(lambda graph, state, x: nnx.merge(graph, state)(x), static_argnums=0)
    want, got = (run(*nnx.split(module.blocks[0]), x) for module in (network, fast))
    np.testing.assert_allclose(got, want, atol=1e-5 * float(want.max()))
