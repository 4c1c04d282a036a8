from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.floors.sensor import SensorConfig, colour_image, depth_image
from ebjax.geometry.camera import camera_over_floor

CAMERA = camera_over_floor(100.0, 100.0, 80.0, 60.0, 160, 120, 0.5, 0.3)
CLEAN = SensorConfig(vignetting=0.0, read_noise=0.0, shot_noise=0.0, depth_noise=0.0, depth_holes=0.0)


def test_clean_sensor_is_the_gamma_curve():
    radiance = jnp.broadcast_to(jnp.linspace(0, 1.5, 160)[None, :, None], (120, 160, 3))
    image = colour_image(radiance, jnp.asarray(0.8), CAMERA, CLEAN, key=jax.random.key(0))
    expected = np.round(255 * np.clip(0.8 * np.asarray(radiance), 0, 1) ** (1 / 2.2))
    assert image.dtype == jnp.uint8 and np.abs(np.asarray(image).astype(int) - expected).max() <= 1


def test_corners_are_darker_and_noise_follows_the_key():
    grey = jnp.full((120, 160, 3), 0.4)
    image = colour_image(grey, jnp.asarray(1.0), CAMERA, replace(CLEAN, vignetting=0.5), key=jax.random.key(0))
    assert image[0, 0, 0] < image[60, 80, 0] - 20
    one, same, other = (
        colour_image(grey, jnp.asarray(1.0), CAMERA, SensorConfig(), key=jax.random.key(k)) for k in (0, 0, 1)
    )
    assert jnp.all(one == same) and jnp.any(one != other)


@pytest.mark.parametrize("distance", [1.0, 2.0, 4.0])
def test_depth_noise_grows_with_the_square_of_the_distance(distance):
    depth = depth_image(jnp.full((120, 160), distance), SensorConfig(), key=jax.random.key(0))
    seen = np.asarray(depth)[np.asarray(depth) > 0] / 1000
    assert depth.dtype == jnp.uint16
    assert seen.mean() == pytest.approx(distance, abs=1e-3)
    assert seen.std() == pytest.approx(0.0035 * distance**2, rel=0.05)
    assert 1 - len(seen) / depth.size == pytest.approx(0.03, abs=0.02)


def test_no_depth_beyond_the_range_or_at_infinity():
    depth = depth_image(jnp.array([[1.0, 8.9, 9.1, jnp.inf]] * 20), CLEAN, key=jax.random.key(0))
    assert depth[0].tolist() == [1000, 8900, 0, 0]
