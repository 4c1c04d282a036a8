import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.geometry.camera import camera_over_floor, image_from_floor
from ebjax.geometry.mount import Mounting, base_from_mounted_camera, remounted
from ebjax.geometry.mount_numbers import mount_of, pose_of, pose_of_homography
from ebjax.slam.world import matrices

MOUNTS = np.array([[0.3, 0.0, 0.0, 0.5, 0.2, 0.0], [0.4, -0.1, 0.2, 1.1, -0.3, 0.1], [-0.2, 0.3, -2.5, 0.8, 0.0, 0.4]])


@pytest.mark.parametrize("mount", MOUNTS)
def test_there_and_back(mount):
    pose = np.asarray(base_from_mounted_camera(mount))
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(mount_of(pose), mount, atol=1e-12)
    np.testing.assert_allclose(pose_of(mount), pose, atol=1e-15)


@pytest.mark.parametrize("mount", MOUNTS)
def test_is_the_camera_over_the_floor_turned_left_and_moved(mount):
    pitch, roll, yaw, height, x, y = mount
    over = camera_over_floor(600.0, 600.0, 320.0, 240.0, 640, 480, height, pitch, roll)
    placed = matrices(np.array([[x, y, yaw]]))[0] @ np.asarray(over.base_from_camera)
    np.testing.assert_allclose(np.asarray(base_from_mounted_camera(mount)), placed, atol=1e-12)


def test_derivative_is_finite_looking_straight_down():
    down = jnp.array([np.pi / 2, 0.0, 0.0, 1.0, 0.0, 0.0])
    assert np.isfinite(np.asarray(jax.jacfwd(base_from_mounted_camera)(down))).all()


def test_corrections_add_up():
    pitch, roll, height = 0.3, 0.05, 0.6
    numbers = (300.0, 310.0, 150.0, 110.0, 320, 240)
    camera = camera_over_floor(*numbers, height, pitch, roll, 0.2)
    found = remounted(camera, Mounting(*map(jnp.asarray, (0.07, -0.02, 0.05))))
    expected = camera_over_floor(*numbers, height + 0.05, pitch + 0.07, roll - 0.02, 0.2)
    np.testing.assert_allclose(found.base_from_camera, expected.base_from_camera, atol=1e-12)


@pytest.mark.parametrize("mount", MOUNTS)
def test_corrections_of_a_camera_that_looks_anywhere(mount):
    camera = camera_over_floor(300.0, 310.0, 150.0, 110.0, 320, 240, 0.6, 0.3)
    camera = dataclasses.replace(camera, base_from_camera=jnp.asarray(pose_of(mount)))
    found = mount_of(np.asarray(remounted(camera, Mounting(*map(jnp.asarray, (0.07, -0.02, 0.05)))).base_from_camera))
    np.testing.assert_allclose(found, mount + np.array([0.07, -0.02, 0, 0.05, 0, 0]), atol=1e-12)


def test_derivatives_in_the_corrections():
    camera = camera_over_floor(300.0, 300.0, 150.0, 110.0, 320, 240, 0.6, 0.3)

    def value(pitch, roll, height):
        return jnp.sum(jnp.sin(image_from_floor(remounted(camera, Mounting(pitch, roll, height))) / 100))

    at = tuple(map(jnp.asarray, (0.02, 0.01, 0.03)))
    for k, slope in enumerate(jax.grad(value, argnums=(0, 1, 2))(*at)):
        step = 1e-6 * np.eye(3)[k]
        numeric = (value(*(a + s for a, s in zip(at, step))) - value(*(a - s for a, s in zip(at, step)))) / 2e-6  # noqa: B905
        assert float(slope) == pytest.approx(float(numeric), rel=1e-7)


@pytest.mark.parametrize(
    "mount", [(0.3, 0.0, 0.0, 0.12, 0.06, 0.0), (0.5, -0.2, 0.4, 1.3, -0.2, 0.1), (0.2, 0.1, 3.0, 0.5, 0.0, 0.0)]
)
@pytest.mark.parametrize("scale", [1.0, -3.0])
def test_a_homography_of_the_floor_tells_the_mount(mount, scale):
    intrinsics = np.array([[300.0, 0, 310], [0, 305, 230], [0, 0, 1]])
    base_from_camera = pose_of(np.array(mount))
    camera_from_base = np.linalg.inv(base_from_camera)
    image_from_floor = intrinsics @ camera_from_base[:3, [0, 1, 3]]
    pose, stretch = pose_of_homography(intrinsics, scale * np.linalg.inv(image_from_floor))
    np.testing.assert_allclose(pose, base_from_camera, atol=1e-9)
    assert stretch < 1e-9
    longer = np.diag([1.3, 1.0, 1.0]) @ intrinsics
    assert pose_of_homography(longer, np.linalg.inv(image_from_floor))[1] > 0.1
