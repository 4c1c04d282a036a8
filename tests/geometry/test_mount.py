import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.geometry.camera import camera_over_floor
from ebjax.geometry.mount import base_from_mounted_camera, mount_of
from ebjax.slam.world import matrices

MOUNTS = np.array([[0.3, 0.0, 0.0, 0.5, 0.2, 0.0], [0.4, -0.1, 0.2, 1.1, -0.3, 0.1], [-0.2, 0.3, -2.5, 0.8, 0.0, 0.4]])


@pytest.mark.parametrize("mount", MOUNTS)
def test_there_and_back(mount):
    pose = np.asarray(base_from_mounted_camera(mount))
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(mount_of(pose), mount, atol=1e-12)


@pytest.mark.parametrize("mount", MOUNTS)
def test_is_the_camera_over_the_floor_turned_left_and_moved(mount):
    pitch, roll, yaw, height, x, y = mount
    over = camera_over_floor(600.0, 600.0, 320.0, 240.0, 640, 480, height, pitch, roll)
    placed = matrices(np.array([[x, y, yaw]]))[0] @ np.asarray(over.base_from_camera)
    np.testing.assert_allclose(np.asarray(base_from_mounted_camera(mount)), placed, atol=1e-12)


def test_derivative_is_finite_looking_straight_down():
    down = jnp.array([np.pi / 2, 0.0, 0.0, 1.0, 0.0, 0.0])
    assert np.isfinite(np.asarray(jax.jacfwd(base_from_mounted_camera)(down))).all()
