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


def test_beyond_its_home_noise_goes_on_without_repeating():
    key, points = jax.random.key(0), jnp.asarray(np.random.default_rng(0).uniform(0, 50, (500, 2)))
    for noise_of in (gradient_noise, fractal_noise):
        assert jnp.all(noise_of(points, key=key, home=64.0) == noise_of(points, key=key))
        far = jnp.stack([noise_of(points + jnp.array([[64.0 * k, 0.0]]), key=key, home=64.0) for k in range(4)])
        assert jnp.abs(jnp.corrcoef(far) - jnp.eye(4)).max() < 0.2 and jnp.all(far.std(axis=1) > 0.1)
    border = jnp.stack([jnp.full(50, 56.0), jnp.linspace(0.0, 9.8, 50)], axis=1)
    step = jnp.array([[1e-7, 0.0]])
    before, after = (gradient_noise(border + s * step, key=key, home=64.0) for s in (-1, 1))
    np.testing.assert_allclose(before, after, atol=1e-6)


def test_octaves_and_warp_follow_the_key_and_the_dtype():
    points = jnp.asarray(np.random.default_rng(0).uniform(0, 8, (50, 2)).astype(np.float32))
    one, two = (fractal_noise(points, key=jax.random.key(k)) for k in (1, 2))
    assert one.dtype == jnp.float32 and jnp.all(one == fractal_noise(points, key=jax.random.key(1)))
    assert jnp.abs(one - two).max() > 0.1
    moved = warped(points, 0.5, key=jax.random.key(0)) - points
    assert moved.dtype == jnp.float32 and 0 < jnp.abs(moved).max() < 0.6
    assert jnp.abs(moved[:, 0] - moved[:, 1]).max() > 0.1
