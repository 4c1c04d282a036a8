import numpy as np

from ebjax.geometry.camera import camera_over_floor, image_from_floor
from ebjax.geometry.homography import apply
from ebjax.views.run_view import choose_floor, from_camera
from ebjax.views.tilted import tilt_of_poses, tilted

CAMERA = camera_over_floor(600.0, 600.0, 320.0, 240.0, 640, 480, 0.6, np.radians(25))


def turned(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    pose = np.eye(4)
    pose[i, i], pose[i, j], pose[j, i], pose[j, j] = c, -s, s, c
    return pose


def driven(pitch=0.0, roll=0.0, slope=0.0):
    """Ten metres on a bend; the base leans, and the floor climbs."""
    poses = []
    for k in range(60):
        heading, way = 0.02 * k, 0.2 * k
        pose = turned(2, heading) @ turned(1, np.radians(pitch) * np.sin(k) - slope) @ turned(0, np.radians(roll))
        pose[:3, 3] = 10 * np.sin(heading), 10 * (1 - np.cos(heading)), way * np.tan(slope)
        poses.append(pose)
    return np.array(poses)


def test_planar_odometry_and_a_tilt_that_never_changes_say_nothing():
    assert tilt_of_poses(driven()) is None
    assert tilt_of_poses(driven(roll=3.0)) is None


def test_the_lean_is_that_of_the_odometry():
    found = tilt_of_poses(driven(pitch=1.0, roll=0.5))
    for k in (3, 20, 50):
        expected = turned(1, np.radians(1.0) * np.sin(k)) @ turned(0, np.radians(0.5))
        np.testing.assert_allclose(found[k], expected, atol=1e-12)


def test_a_slope_of_the_floor_is_no_lean():
    found = tilt_of_poses(driven(pitch=1.0, slope=np.radians(4.0)))
    for k in (10, 30, 50):
        np.testing.assert_allclose(found[k], turned(1, np.radians(1.0) * np.sin(k)), atol=2e-3)


def test_a_tilted_view_shows_the_same_floor():
    view = from_camera(CAMERA, choose_floor(CAMERA, 0.01))
    lean = turned(1, np.radians(1.5)) @ turned(0, np.radians(-0.7))
    seen, camera = tilted(view, CAMERA, lean)
    pixels = np.array([[10.0, 20.0], [150.0, 60.0], [90.0, 190.0]])
    floor = apply(seen.floor_from_view, pixels)
    np.testing.assert_array_equal(seen.floor_from_view, view.floor_from_view)
    np.testing.assert_allclose(apply(seen.image_from_view, pixels), apply(image_from_floor(camera), floor), atol=1e-9)
    assert (np.asarray(seen.seen) <= np.asarray(view.seen)).all()
    same, _ = tilted(view, CAMERA, np.eye(4))
    np.testing.assert_allclose(same.image_from_view, view.image_from_view, atol=1e-9)
