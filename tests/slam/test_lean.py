import numpy as np
import pytest

from ebjax.geometry.camera import camera_over_floor
from ebjax.geometry.lean_numbers import turned
from ebjax.slam.lean import shown_by_depth

WIDTH, HEIGHT = 320, 240


def depth_of_the_floor(camera, level_from_base, noise, random):
    """Stereo depth of a bare floor from a robot that leans, m; beyond 4 m there is none."""
    pose = level_from_base @ np.asarray(camera.base_from_camera, np.float64)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(np.asarray(camera.intrinsics, np.float64)).T
    down = -(rays @ pose[2, :3])
    depth = np.where(down > 0, pose[2, 3] / np.where(down > 0, down, 1), 0)
    depth = depth + noise * depth**2 * random.standard_normal(depth.shape)
    return np.where((depth > 0) & (depth < 4), depth, 0).astype(np.float32)


@pytest.mark.parametrize("pitch_deg, height_m, noise", [(25.0, 0.6, 0.0), (30.0, 0.4, 0.004), (20.0, 1.0, 0.008)])
def test_depth_tells_how_the_robot_leans_against_its_usual_stand(pitch_deg, height_m, noise):
    random = np.random.default_rng(0)
    camera = camera_over_floor(300.0, 300.0, 159.5, 119.5, WIDTH, HEIGHT, height_m, np.radians(pitch_deg), 0.0, 0.2)
    nods = np.radians(random.uniform(-1.2, 1.2, (2, 9)))
    nods -= np.median(nods, axis=1, keepdims=True)
    level_from_base = turned(1, nods[0]) @ turned(0, nods[1])
    images = {2 * k: depth_of_the_floor(camera, level, noise, random) for k, level in enumerate(level_from_base)}
    images[6] = None
    rgb = np.zeros((HEIGHT, WIDTH, 3), np.uint8)

    def load(frame):
        return (rgb, images[frame])

    found = shown_by_depth(load, np.arange(0, 18, 2), camera, 18)
    known = np.array([k for k in range(9) if images[2 * k] is not None])
    np.testing.assert_array_equal(found[6], np.eye(4))
    np.testing.assert_array_equal(found[1::2], np.tile(np.eye(4), (9, 1, 1)))
    off = np.degrees(found[2 * known][:, 2, :2] - level_from_base[known][:, 2, :2])
    off -= np.median(off, axis=0)
    np.testing.assert_allclose(off, 0, atol=0.001 if not noise else 0.1)


def test_a_robot_that_stands_upright_leans_not_at_all():
    random = np.random.default_rng(0)
    camera = camera_over_floor(300.0, 300.0, 159.5, 119.5, WIDTH, HEIGHT, 0.6, 0.4, 0.0, 0.2)
    depth = depth_of_the_floor(camera, np.eye(4), 0.002, random)
    rgb = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    assert shown_by_depth(lambda frame: (rgb, depth), np.arange(4), camera, 4) is None
    assert shown_by_depth(lambda frame: (rgb, None), np.arange(4), camera, 4) is None
    assert shown_by_depth(lambda frame: None, np.arange(4), camera, 4) is None
