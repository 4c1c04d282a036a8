import numpy as np
import pytest

from ebjax.geometry.camera import FloorView, camera_over_floor
from ebjax.slam.look_again import NEAR_PX, range_again
from ebjax.views.run_view import from_camera

CAMERA = camera_over_floor(260.0, 260.0, 159.5, 119.5, 320, 240, 0.5, float(np.radians(35)))
VIEW = from_camera(CAMERA, FloorView(0.5, 1.5, -0.5, 0.5, 0.01))


def ranges_to(keypoints, height_m):
    """Along the optical axis to a plane so high above the floor, by the rays' own geometry."""
    pose = np.asarray(CAMERA.base_from_camera, float)
    x, y, w = np.asarray(VIEW.floor_from_view, float) @ np.column_stack([keypoints, np.ones(len(keypoints))]).T
    ray = np.stack([x / w, y / w, 0 * x], 1) - pose[:3, 3]
    point = pose[:3, 3] + ray * (1 - height_m / pose[2, 3])
    return (point - pose[:3, 3]) @ pose[:3, 2]


@pytest.mark.parametrize("height_m", [0.0, 0.04, -0.02])
def test_the_floor_is_as_high_as_the_nearest_feature_says(height_m):
    rng = np.random.default_rng(0)
    was = rng.uniform(0, 99, (300, 2)).astype(np.float32)
    kept = {"features.keypoints": was, "features.range_m": ranges_to(was, height_m).astype(np.float32)}
    moved = was + rng.uniform(-1, 1, was.shape)
    np.testing.assert_allclose(range_again(moved, kept, VIEW, CAMERA), ranges_to(moved, height_m), rtol=1e-5)


def test_nothing_near_says_no_depth():
    was = np.array([[20.0, 20.0], [60.0, 60.0]], np.float32)
    kept = {"features.keypoints": was, "features.range_m": np.array([0.0, ranges_to(was, 0)[1]], np.float32)}
    asked = np.array([[20.0, 20.0], [60.0, 60.0 + 1.1 * NEAR_PX], [60.0, 60.0 + 0.9 * NEAR_PX]])
    assert (range_again(asked, kept, VIEW, CAMERA) > 0).tolist() == [False, False, True]
    assert not range_again(asked, kept | {"features.range_m": np.zeros(2, np.float32)}, VIEW, CAMERA).any()
    turned = {f"turned.{name.split('.')[1]}": values for name, values in kept.items()}
    nothing = {"features.keypoints": np.zeros((0, 2)), "features.range_m": np.zeros(0)}
    assert range_again(asked, nothing | turned, VIEW, CAMERA)[2] > 0
