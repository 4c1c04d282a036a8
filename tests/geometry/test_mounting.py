"""A camera's mounting, corrected."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.geometry.camera import camera_over_floor, image_from_floor
from ebjax.geometry.mounting import Mounting, remounted


def test_corrections_add_up():
    pitch, roll, height = 0.3, 0.05, 0.6
    numbers = (300.0, 310.0, 150.0, 110.0, 320, 240)
    camera = camera_over_floor(*numbers, height, pitch, roll, 0.2)
    found = remounted(camera, Mounting(*map(jnp.asarray, (0.07, -0.02, 0.05))))
    expected = camera_over_floor(*numbers, height + 0.05, pitch + 0.07, roll - 0.02, 0.2)
    np.testing.assert_allclose(found.base_from_camera, expected.base_from_camera, atol=1e-12)


def test_derivatives():
    camera = camera_over_floor(300.0, 300.0, 150.0, 110.0, 320, 240, 0.6, 0.3)

    def value(pitch, roll, height):
        return jnp.sum(jnp.sin(image_from_floor(remounted(camera, Mounting(pitch, roll, height))) / 100))

    at = tuple(map(jnp.asarray, (0.02, 0.01, 0.03)))
    for k, slope in enumerate(jax.grad(value, argnums=(0, 1, 2))(*at)):
        step = 1e-6 * np.eye(3)[k]
        numeric = (value(*(a + s for a, s in zip(at, step))) - value(*(a - s for a, s in zip(at, step)))) / 2e-6  # noqa: B905
        assert float(slope) == pytest.approx(float(numeric), rel=1e-7)
