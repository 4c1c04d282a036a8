import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from scipy.signal import correlate2d

from ebjax.models.layers import Conv, Stack, avg_pool, imagenet, max_pool, normalise


@pytest.fixture
def x():
    return jnp.asarray(np.random.default_rng(0).normal(size=(2, 9, 8, 3)), jnp.float32)


@pytest.mark.parametrize("options", [{}, {"stride": 2}, {"dilation": 2}, {"size": 7, "stride": 2}, {"padding": 0}])
def test_conv_is_a_correlation(x, options):
    layer = Conv(3, 4, rngs=nnx.Rngs(1), **options)
    layer.bias[...] = jnp.arange(4, dtype=jnp.float32)
    kernel, dilation = np.asarray(layer.kernel[...], np.float64), layer.dilation
    spread = np.zeros(((kernel.shape[0] - 1) * dilation + 1,) * 2 + kernel.shape[2:])
    spread[::dilation, ::dilation] = kernel
    pad = layer.padding
    padded = np.pad(np.asarray(x, np.float64), ((0, 0), (pad, pad), (pad, pad), (0, 0)))
    want = [
        [sum(correlate2d(image[..., i], spread[..., i, o], "valid") for i in range(3)) + o for o in range(4)]
        for image in padded
    ]
    want = np.moveaxis(np.array(want), 1, -1)[:, :: layer.stride, :: layer.stride]
    got = layer(x)
    assert got.dtype == jnp.float32
    np.testing.assert_allclose(got, want, atol=1e-5)


@pytest.mark.parametrize("stride", [1, 2])
def test_pointwise_conv_is_the_general_one(x, stride):
    layer = Conv(3, 5, 1, stride=stride, rngs=nnx.Rngs(0))
    general = jax.lax.conv_general_dilated(
        x, layer.kernel[...], (stride, stride), "VALID", dimension_numbers=("NHWC", "HWIO", "NHWC")
    )
    np.testing.assert_allclose(layer(x), general, atol=1e-6)


def test_pools_leave_out_what_does_not_fill_a_window(x):
    assert max_pool(x).shape == (2, 4, 4, 3)
    np.testing.assert_array_equal(max_pool(x)[:, 1, 2], x[:, 2:4, 4:6].max((1, 2)))
    np.testing.assert_array_equal(max_pool(x, 3, 2, 1)[:, 0, 1], x[:, :2, 1:4].max((1, 2)))
    np.testing.assert_allclose(avg_pool(x, stride=1)[:, 3, 5], x[:, 3:5, 5:7].mean((1, 2)), atol=1e-6)
    assert avg_pool(x, stride=1).shape == (2, 8, 7, 3)


def test_normalise_has_a_gradient_at_zero():
    rows = jnp.array([[3.0, 4.0], [0.0, 0.0]])
    np.testing.assert_allclose(normalise(rows), [[0.6, 0.8], [0, 0]])
    assert np.isfinite(jax.grad(lambda r: normalise(r).sum())(rows)).all()


def test_imagenet_is_zero_mean_unit_deviation():
    image = jnp.broadcast_to(jnp.array([0.485, 0.456, 0.406]), (1, 2, 2, 3))
    np.testing.assert_allclose(imagenet(image), 0, atol=1e-7)
    np.testing.assert_allclose(imagenet(image + jnp.array([0.229, 0.224, 0.225])[None, None, None, :]), 1, atol=1e-6)


def test_stack_shapes_names_and_order(x):
    stack = Stack((2, 1), pools=("max", ""), rngs=nnx.Rngs(0))
    assert stack.layer_names() == ["conv1_1", "relu1_1", "conv1_2", "relu1_2", "pool1", "conv2_1", "relu2_1"]
    maps = stack.taps(x, ("relu2_1", "conv1_1", "relu1_1"))
    assert maps["conv1_1"].shape == (2, 9, 8, 64) and maps["relu2_1"].shape == (2, 4, 4, 128)
    np.testing.assert_array_equal(maps["relu1_1"], np.maximum(maps["conv1_1"], 0))
    with pytest.raises(ValueError, match="no layer 'conv3_1'; there are conv1_1"):
        stack.taps(x, ("conv3_1",))


def test_dilation_and_the_average_pool_keep_the_grid(x):
    stack = Stack((1, 1, 1), pools=("max", "avg", ""), dilations=(1, 1, 2), rngs=nnx.Rngs(0))
    assert stack.taps(x, ("conv3_1",))["conv3_1"].shape == (2, 3, 3, 256)


def test_stand_in_is_seeded_orthogonal_and_translation_equivariant():
    first, again, other = (Stack((2, 1), rngs=nnx.Rngs(seed)) for seed in (5, 5, 6))
    kernel = np.asarray(first.conv2_1.kernel[...]).reshape(-1, 128)
    np.testing.assert_allclose(kernel.T @ kernel, 2 * np.eye(128), atol=1e-4)
    np.testing.assert_array_equal(kernel, np.asarray(again.conv2_1.kernel[...]).reshape(-1, 128))
    assert not np.array_equal(kernel, np.asarray(other.conv2_1.kernel[...]).reshape(-1, 128))
    image = jnp.asarray(np.random.default_rng(1).uniform(size=(1, 40, 40, 3)), jnp.float32)
    still, moved = (first.taps(i, ("pool2",))["pool2"] for i in (image, jnp.roll(image, 4, 2)))
    np.testing.assert_allclose(moved[:, :, 4:-3], still[:, :, 3:-4], atol=1e-5)


def test_float64_stays_float64_and_gradients_are_right():
    stack = Stack((1, 1), rngs=nnx.Rngs(0))
    graph, state = nnx.split(jax.tree.map(lambda leaf: leaf.astype(jnp.float64), stack))
    x = jnp.asarray(np.random.default_rng(2).normal(size=(1, 6, 6, 3)))

    def loss(state):
        y = nnx.merge(graph, state).taps(x, ("pool2",))["pool2"]
        assert y.dtype == jnp.float64
        return jnp.sum(jnp.sin(y))

    gradient = jax.grad(loss)(state)
    direction = jax.tree.map(lambda leaf: jnp.cos(jnp.arange(leaf.size, dtype=leaf.dtype)).reshape(leaf.shape), state)
    step = 1e-6
    ends = [loss(jax.tree.map(lambda p, d, s=sign: p + s * step * d, state, direction)) for sign in (1, -1)]
    slope = sum(jnp.vdot(a, b) for a, b in zip(*map(jax.tree.leaves, (gradient, direction)), strict=True))
    np.testing.assert_allclose((ends[0] - ends[1]) / (2 * step), slope, rtol=1e-5)
