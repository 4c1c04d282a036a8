import numpy as np
import pytest

from ebjax.floors.cameras import MODELS, CameraConfig, check, make_camera
from ebjax.geometry.camera import project


@pytest.mark.parametrize("model", MODELS)
def test_a_smaller_image_is_the_same_view(model):
    full, small = make_camera(CameraConfig(model)), make_camera(CameraConfig(model, width=320))
    points = np.array([[2.0, 0.3, 0.0], [4.0, -0.5, 0.2]], np.float32)
    scale = 320 / MODELS[model].width
    a, b = (np.asarray(project(camera, points)[0]) for camera in (full, small))
    np.testing.assert_allclose((a + 0.5) * scale - 0.5, b, atol=1e-2)
    assert (small.width, small.height) == (320, round(MODELS[model].height * scale))


def test_the_phone_sees_the_authors_quad_as_a_rectangle():
    quad = np.array([[544, 649], [1379, 646], [1602, 1049], [300, 1045]], np.float64)
    camera = make_camera(CameraConfig("phone"))
    k, pose = np.asarray(camera.intrinsics, np.float64), np.asarray(camera.base_from_camera, np.float64)
    rays = np.linalg.solve(k, np.append(quad, np.ones((4, 1)), axis=1).T).T @ pose[:3, :3].T
    floor = rays[:, :2] * (-pose[2, 3] / rays[:, 2])[:, None]
    width = np.abs(floor[[0, 3], 1] - floor[[1, 2], 1])
    assert width[0] == pytest.approx(width[1], rel=0.03)


@pytest.mark.parametrize("key, value", [("width", 4), ("height_m", -1.0), ("pitch_deg", 120.0)])
def test_bad_values_name_their_key(key, value):
    with pytest.raises(ValueError, match=f"camera.{key} is"):
        check(CameraConfig(**{key: value}))
