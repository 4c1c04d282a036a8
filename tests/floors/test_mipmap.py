import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.floors import mipmap


@pytest.fixture
def image():
    return jnp.asarray(np.random.default_rng(0).uniform(size=(45, 70, 3)).astype(np.float32))


def test_fine_footprint_gives_the_texels_back(image):
    mip = mipmap.build(image, 4)
    x, y = jnp.meshgrid(jnp.arange(70, dtype=jnp.float32), jnp.arange(45, dtype=jnp.float32))
    found = mipmap.sample(mip, jnp.stack([x, y], -1), jnp.full((45, 70), 0.3, jnp.float32))
    np.testing.assert_allclose(found, image, atol=1e-6)
    assert found.dtype == jnp.float32


@pytest.mark.parametrize("level", [1, 2, 3])
def test_a_block_is_averaged_at_its_level(image, level):
    mip, side = mipmap.build(image, 4), 2**level
    centre = jnp.array([[2.5 * side - 0.5, 1.5 * side - 0.5]], jnp.float32)
    found = mipmap.sample(mip, centre, jnp.full(1, float(side), jnp.float32))
    np.testing.assert_allclose(found[0], image[side : 2 * side, 2 * side : 3 * side].mean((0, 1)), atol=1e-6)


def test_levels_change_smoothly_and_end_at_the_coarsest(image):
    mip = mipmap.build(image, 4)
    footprints = jnp.geomspace(0.5, 1000.0, 4000).astype(jnp.float32)
    found = mipmap.sample(mip, jnp.full((4000, 2), 20.3, jnp.float32), footprints)
    assert jnp.abs(jnp.diff(found, axis=0)).max() < 0.01
    assert jnp.ptp(found[-500:]) < 1.0 and jnp.all(found[-1] == found[-2])


def test_anisotropic_taps_keep_a_line_along_the_long_axis():
    lines = jnp.broadcast_to((jnp.arange(64) % 16 == 8).astype(jnp.float32)[None, :, None], (64, 64, 1))
    mip = mipmap.build(lines, 6)
    point, axes = jnp.array([[24.0, 32.0]], jnp.float32), jnp.array([[[1.0, 0.0], [0.0, 8.0]]], jnp.float32)
    sharp = [float(mipmap.sample_anisotropic(mip, point, axes, taps)[0, 0]) for taps in (1, 2, 8)]
    assert sharp[0] < sharp[1] < sharp[2] and sharp[2] == pytest.approx(1.0)


def test_gradient_agrees_with_central_differences():
    mip = mipmap.build(jnp.asarray(np.random.default_rng(1).uniform(size=(16, 16, 1))), 3)

    def value(point):
        return mipmap.sample(mip, point, jnp.asarray(2.6))[0]

    point, eps = jnp.array([6.3, 7.4]), 1e-6
    steps = eps * jnp.eye(2)
    numeric = jnp.stack([(value(point + s) - value(point - s)) / (2 * eps) for s in steps])
    np.testing.assert_allclose(jax.grad(value)(point), numeric, rtol=1e-6)
