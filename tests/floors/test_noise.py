import jax
import jax.numpy as jnp
import numpy as np

from ebjax.floors import noise

gradient_noise = jax.jit(noise.gradient_noise, static_argnames="period")
fractal_noise = jax.jit(noise.fractal_noise)
warped = jax.jit(noise.warped, static_argnums=1)


def test_noise_is_zero_on_the_lattice_periodic_and_smooth():
    key, points = jax.random.key(0), jnp.asarray(np.random.default_rng(0).uniform(0, 8, (500, 2)))
    assert jnp.all(gradient_noise(jnp.round(points), key=key) == 0)
    values = gradient_noise(points, key=key, period=8)
    np.testing.assert_allclose(gradient_noise(points + 8.0, key=key, period=8), values, atol=1e-12)
    np.testing.assert_allclose(gradient_noise(points + 1e-7, key=key, period=8), values, atol=1e-6)
    assert 0.1 < values.std() < 0.5 and jnp.abs(values).max() < 1


def test_octaves_and_warp_follow_the_key_and_the_dtype():
    points = jnp.asarray(np.random.default_rng(0).uniform(0, 8, (50, 2)).astype(np.float32))
    one, two = (fractal_noise(points, key=jax.random.key(k)) for k in (1, 2))
    assert one.dtype == jnp.float32 and jnp.all(one == fractal_noise(points, key=jax.random.key(1)))
    assert jnp.abs(one - two).max() > 0.1
    moved = warped(points, 0.5, key=jax.random.key(0)) - points
    assert moved.dtype == jnp.float32 and 0 < jnp.abs(moved).max() < 0.6
    assert jnp.abs(moved[:, 0] - moved[:, 1]).max() > 0.1
