"""The ground plane of rendered and recorded depth: the floor, not the wall, the table or the ceiling."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.geometry import camera as cameras
from ebjax.geometry import plane

KEY = jax.random.key(0)


def room(height_m=0.8, pitch=0.35, roll=-0.1, wall_x=3.0, ceiling_m=2.5, noise=0.002, seed=0):
    """Points of a camera in a room, every fourth pixel: floor, a wall ahead, and a ceiling."""
    camera = cameras.camera_over_floor(300, 300, 160, 120, 320, 240, height_m, pitch, roll)
    pose = np.array(camera.base_from_camera)
    rows, cols = np.mgrid[0:240:4, 0:320:4]
    pixels = np.stack([cols.ravel(), rows.ravel()], axis=1).astype(float)
    rays = np.array(cameras.backproject(pixels, np.ones(len(pixels)), camera.intrinsics))
    directions = rays @ pose[:3, :3].T
    with np.errstate(divide="ignore"):
        depths = [-height_m / directions[:, 2], (ceiling_m - height_m) / directions[:, 2], wall_x / directions[:, 0]]
    depth = np.min([np.where(d > 0, d, np.inf) for d in depths], axis=0)
    floor = depth == depths[0]
    depth += np.random.default_rng(seed).normal(0, noise, depth.shape) * depth**2
    return np.array(cameras.backproject(pixels, depth, camera.intrinsics)), floor, camera


@pytest.mark.parametrize("pitch", [0.1, 0.35, 0.7])
def test_the_floor_of_a_room_gives_its_camera(pitch):
    points, floor, camera = room(pitch=pitch)
    fitted, inliers = plane.fit_ground_plane(points, np.ones(len(points), bool), key=KEY)
    assert np.mean(np.array(inliers)[floor]) > 0.95 and np.sum(np.array(inliers)[~floor]) < 0.1 * floor.sum()
    found = plane.camera_from_plane(fitted, camera.intrinsics, 320, 240)
    np.testing.assert_allclose(found.base_from_camera[2, 3], 0.8, atol=0.003)
    np.testing.assert_allclose(found.base_from_camera, camera.base_from_camera, atol=0.005)


def test_a_low_ceiling_and_a_wall_larger_than_the_floor_are_not_chosen():
    points, floor, _ = room(pitch=-0.1, roll=0.0, wall_x=8.0, ceiling_m=1.2, noise=0.0005)
    assert floor.mean() < 0.25
    fitted, inliers = plane.fit_ground_plane(points, np.ones(len(points), bool), key=KEY)
    assert np.mean(np.array(inliers)[floor]) > 0.95
    np.testing.assert_allclose(fitted[3], 0.8, atol=0.005)


def test_the_exact_plane_goes_to_the_camera_it_came_from():
    camera = cameras.camera_over_floor(300, 300, 160, 120, 320, 240, 0.54, 0.33, 0.05, 0.27)
    pose = np.array(camera.base_from_camera)
    exact = np.concatenate([pose[2, :3], pose[2:3, 3]])
    found = plane.camera_from_plane(exact, camera.intrinsics, 320, 240, x_m=0.27, y_m=-0.1)
    np.testing.assert_allclose(found.base_from_camera[:2, 3], [0.27, -0.1])
    np.testing.assert_allclose(found.base_from_camera[:, :3], pose[:, :3], atol=1e-12)
    jacobian = jax.jacfwd(lambda p: plane.camera_from_plane(p, camera.intrinsics, 320, 240).base_from_camera)(exact)
    assert np.isfinite(jacobian).all()


@pytest.mark.parametrize("valid", [0, 2])
def test_without_depth_there_is_no_floor(valid):
    points, _, _ = room()
    points[10:20] = np.nan
    fitted, inliers = plane.fit_ground_plane(points, np.arange(len(points)) < valid, key=KEY)
    assert not inliers.any() and fitted[3] == 0 and np.isfinite(fitted).all()


def test_float32_and_vmap():
    points = np.stack([room(seed=s)[0] for s in range(2)]).astype(np.float32)
    valid = np.ones(points.shape[:2], bool)
    fitted, inliers = jax.vmap(lambda p, v: plane.fit_ground_plane(p, v, key=KEY))(points, valid)
    assert fitted.dtype == jnp.float32 and inliers.shape == valid.shape
    np.testing.assert_allclose(fitted[:, 3], 0.8, atol=0.005)


def recorded(path, intrinsics, units_per_metre):
    depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[::2, ::2] / units_per_metre
    rows, cols = np.mgrid[0:480:2, 0:640:2]
    pixels = np.stack([cols.ravel(), rows.ravel()], axis=1).astype(np.float32)
    return cameras.backproject(pixels, depth.ravel().astype(np.float32), intrinsics), depth.ravel() > 0


def test_the_corridor_camera_is_found(data):
    k = np.array([[615.0, 0, 320], [0, 615, 240], [0, 0, 1]], np.float32)
    for path in sorted((data("corridor_rgbd") / "depth").iterdir())[::60]:
        fitted, _ = plane.fit_ground_plane(*recorded(path, k, 1000.0), key=KEY)
        pose = plane.camera_from_plane(fitted, k, 640, 480).base_from_camera
        assert abs(pose[2, 3] - 0.54) < 0.003
        assert abs(np.rad2deg(np.arcsin(-pose[2, 2])) - 19) < 0.15


def test_the_floor_of_a_real_room_is_found_whatever_the_key(data):
    folder = data("rgbd_realsense_pairs")
    fx, fy, cx, cy, scale = (float(x) for x in (folder / "camera.txt").read_text().split())
    k = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float32)
    for name, height_m in (("1_1", 1.287), ("1_2", 1.148), ("2_1", 1.527), ("2_2", 1.423)):
        points, valid = recorded(folder / f"depth{name}.png", k, scale)
        for seed in range(5):
            fitted, _ = plane.fit_ground_plane(points, valid, key=jax.random.key(seed))
            assert abs(fitted[3] - height_m) < 0.01
