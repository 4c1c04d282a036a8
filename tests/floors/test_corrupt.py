import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from ebjax.floors import corrupt as module
from ebjax.floors.corrupt import corrupt

SIZE = (90, 110)
OFF = {
    "ROTATION_DEG": 0.0,
    "SCALE": 0.0,
    "BLUR": 0.0,
    "GAMMA": (1.0, 1.0),
    "SHADOW": (1.0, 1.0),
    "SPOT": 0.0,
    "NOISE": 0.0,
}


@pytest.fixture
def only(monkeypatch):
    """Switches all corruptions off but some; gives the function anew, for the constants are compiled in."""

    def switch(*names):
        for name in OFF.keys() - set(names):
            monkeypatch.setattr(module, name, OFF[name])
        return jax.jit(lambda *view, key: corrupt.__wrapped__(*view, key=key))

    return switch


def view(sigma=4.0):
    noise = gaussian_filter(np.random.default_rng(0).standard_normal((*SIZE, 3)), (sigma, sigma, 0), mode="wrap")
    return jnp.asarray(np.clip(0.5 + 0.15 * noise / noise.std(), 0.05, 0.95), jnp.float32)


def seen():
    return jnp.ones(SIZE, bool).at[:, :10].set(False)


def test_no_strength_changes_nothing():
    same, still = corrupt(view(), seen(), 0.0, key=jax.random.key(1))
    np.testing.assert_allclose(same, view(), atol=2e-6)
    np.testing.assert_array_equal(still, seen())


def test_the_key_says_how_and_dtype_follows():
    first, again, other = (corrupt(view(), seen(), key=jax.random.key(k))[0] for k in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert float(jnp.abs(first - other).mean()) > 0.02 < float(jnp.abs(first - view()).mean())
    assert first.dtype == jnp.float32 and float(first.min()) >= 0 and float(first.max()) <= 1
    double = jax.eval_shape(lambda v: corrupt(v, seen(), key=jax.random.key(1))[0], view().astype(jnp.float64))
    assert double.dtype == jnp.float64


def test_the_field_of_view_only_shrinks_and_what_is_seen_is_floor(only):
    moved = only("ROTATION_DEG", "SCALE", "BLUR")
    for k in range(8):
        got, still = moved(jnp.where(seen()[..., None], 0.5, jnp.zeros(3)), seen(), key=jax.random.key(k))
        assert not bool((still & ~seen()).any()) and 0.6 < float(still.sum() / seen().sum()) <= 1
        np.testing.assert_allclose(np.asarray(got)[np.asarray(still)], 0.5, atol=0.006)


def test_turning_back_gives_the_view(only):
    turned = only("ROTATION_DEG")
    for k in range(4):
        got, _ = turned(view(), seen(), key=jax.random.key(k))
        drawn = jax.random.uniform(jax.random.split(jax.random.key(k))[0], (11,), jnp.float32)
        angle = np.radians(module.ROTATION_DEG) * (2 * float(drawn[0]) - 1)
        c, s = np.cos(angle), np.sin(angle)
        x, y = np.meshgrid(np.arange(40, 70.0) - 54.5, np.arange(30, 60.0) - 44.5)
        points = jnp.asarray(np.stack([c * x + s * y + 54.5, -s * x + c * y + 44.5], -1), jnp.float32)
        back = module.sample_bilinear(got, points)
        np.testing.assert_allclose(back, view()[30:60, 40:70], atol=0.02)


def test_gamma_keeps_the_order_of_values(only):
    toned = np.asarray(only("GAMMA")(view(), seen(), key=jax.random.key(3))[0])
    assert np.corrcoef(toned.ravel(), np.asarray(view()).ravel())[0, 1] > 0.97
    assert (np.diff(toned.ravel()[np.argsort(np.asarray(view()).ravel())]) >= -1e-6).all()


def test_a_shadow_has_two_sides(only):
    ratio = np.asarray(only("SHADOW")(view(), seen(), key=jax.random.key(3))[0] / view())[..., 0]
    low, high = module.SHADOW
    assert ratio.max() == pytest.approx(1, abs=1e-5) and low <= ratio.min() <= high
    assert ((ratio > ratio.min() + 1e-4) & (ratio < 1 - 1e-4)).mean() < 0.03


def test_a_spot_saturates(only):
    bright = [np.asarray(only("SPOT")(view(), seen(), key=jax.random.key(k))[0]) for k in range(4)]
    assert all(0 < (one == 1).all(-1).mean() < 0.2 for one in bright)


def test_noise_has_its_spread(only):
    noisy = only("NOISE")(view(), seen(), key=jax.random.key(0))[0]
    assert float((noisy - view()).std()) == pytest.approx(module.NOISE, rel=0.05)
