import dataclasses
from pathlib import Path

import numpy as np
import pytest

from ebjax.floors.cameras import MODELS, CameraConfig, check, make_camera, position
from ebjax.geometry.camera import project, raw_from_ideal, rays_of


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


@dataclasses.dataclass(frozen=True)
class Calibrated:
    """What `read_calibration` says of a file."""

    width: int = 1280
    height: int = 960
    intrinsics: np.ndarray = dataclasses.field(
        default_factory=lambda: np.array([[600, 0, 650], [0, 610, 470], [0, 0, 1.0]])
    )
    distortion_model: str = "equidistant"
    distortion: tuple[float, ...] = (0.03, 0.01, -0.02, 0.005)
    base_from_camera: np.ndarray | None = None


def test_gopro_wide_sees_120_degrees_across():
    camera = make_camera(CameraConfig("gopro-wide"))
    assert camera.lens.model == "equidistant" and camera.size == (960, 1280)
    rays, shown = rays_of(camera, np.array([[-0.5, 479.5], [1279.5, 479.5], [-0.5, -0.5], [1279.5, 959.5]]))
    angle = np.degrees(np.arccos(rays[:, 2]))
    assert shown.all() and angle[:2].sum() == pytest.approx(120, abs=0.5) and angle.max() < 87


def test_phone_raw_is_the_phone_through_its_lens():
    straight, raw = make_camera(CameraConfig("phone")), make_camera(CameraConfig("phone-raw"))
    assert np.all(straight.intrinsics == raw.intrinsics) and np.all(straight.base_from_camera == raw.base_from_camera)
    corners = np.array([[0.0, 0.0], [1919, 0], [1919, 1079], [0, 1079]], np.float32)
    moved = np.linalg.norm(np.asarray(raw_from_ideal(raw, corners)) - corners, axis=1)
    assert moved.min() > 5 and moved.max() < 40 and np.ptp(moved) > 1
    own = make_camera(CameraConfig("phone-raw", distortion_model="pinhole"))
    assert own.lens.model == "pinhole" and len(own.lens.coefficients) == 0


def test_a_calibration_gives_intrinsics_size_lens_and_mount():
    config = CameraConfig("phone", file=Path("camera.yaml"), width=640)
    camera = make_camera(config, Calibrated())
    k = np.asarray(camera.intrinsics)
    np.testing.assert_allclose(k[[0, 1], [0, 1]], [300, 305])
    np.testing.assert_allclose(k[:2, 2], [650.5 / 2 - 0.5, 470.5 / 2 - 0.5])
    assert camera.size == (480, 640) and camera.lens.model == "equidistant"
    np.testing.assert_allclose(camera.lens.coefficients, Calibrated().distortion, rtol=1e-6)
    np.testing.assert_allclose(camera.base_from_camera, make_camera(CameraConfig("phone")).base_from_camera)
    mount = np.array([[0, -0.6, 0.8, 0.3], [-1, 0, 0, 0.05], [0, -0.8, -0.6, 0.7], [0, 0, 0, 1.0]])
    mounted = Calibrated(base_from_camera=mount)
    np.testing.assert_allclose(make_camera(config, mounted).base_from_camera, mount, atol=1e-7)
    np.testing.assert_allclose(position(config, mounted), [0.3, 0.05, 0.7])
    check(config, mounted)
    with pytest.raises(ValueError, match=r"^camera\.pitch_deg is 20\.0: the mount is that of camera\.file"):
        check(dataclasses.replace(config, pitch_deg=20.0), mounted)
    mount[2, 3] = 3.0
    with pytest.raises(ValueError, match=r"^camera\.file is camera\.yaml: its camera is 3 m above"):
        check(config, mounted)


@pytest.mark.parametrize(
    "config, message",
    [
        (CameraConfig(distortion=(0.1, 0.0)), "camera.distortion is .*needs camera.distortion_model"),
        (CameraConfig(distortion_model="plumb_bob", distortion=(0.1,)), "camera.distortion is .*4 or 5"),
        (
            CameraConfig(distortion_model="equidistant", distortion=(0.1,) * 4, file=Path("a.yaml")),
            "camera.distortion_model is 'equidistant': the lens is that of camera.file",
        ),
    ],
)
def test_a_lens_that_cannot_be_names_its_key(config, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        check(config)
