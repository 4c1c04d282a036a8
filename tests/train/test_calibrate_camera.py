import cv2
import numpy as np
import pytest

from ebjax.geometry.camera import Camera, rays_of
from ebjax.geometry.lens import PINHOLE, lens
from ebjax.geometry.mount import base_from_mounted_camera
from ebjax.train.calibrate_camera import COEFFICIENTS, coefficient_sigmas, names, numbers_of, with_numbers

MOUNT = np.array([0.4, 0.02, -0.1, 0.6, 0.2, 0.05])
LENSES = [
    PINHOLE,
    lens("plumb_bob", [-0.2, 0.05, 1e-3, -2e-3]),
    lens("plumb_bob", [0.15, -0.3, 8e-4, -6e-4, 0.16]),
    lens("rational_polynomial", [0.3, -0.1, 1e-3, 2e-3, 0.02, 0.35, -0.05, 0.01]),
    lens("equidistant", [0.045, 0.012, -0.02, 0.006]),
    lens("omnidirectional", [0.8, -0.1, 0.02, 1e-3, -1e-3]),
]


def camera_with(bent, width=640, height=480):
    k = np.array([[400.0, 0.5, 310.0], [0, 404.0, 245.0], [0, 0, 1]])
    return Camera(k, np.asarray(base_from_mounted_camera(MOUNT)), width, height, bent)


@pytest.mark.parametrize("bent", LENSES, ids=lambda bent: bent.model)
def test_numbers_say_all_of_a_camera(bent):
    camera = camera_with(bent)
    numbers = numbers_of(camera)
    assert len(numbers) == len(names(camera)) == len(set(names(camera)))
    again = with_numbers(camera, numbers)
    np.testing.assert_allclose(again.intrinsics, camera.intrinsics, rtol=1e-15)
    np.testing.assert_allclose(again.base_from_camera, camera.base_from_camera, atol=1e-15)
    np.testing.assert_array_equal(again.lens.coefficients, bent.coefficients)
    numbers[names(camera).index("fx")] *= 1.1
    longer = np.asarray(with_numbers(camera, numbers).intrinsics)
    assert longer[1, 1] / longer[0, 0] == pytest.approx(404 / 400) and longer[0, 2] == 310


@pytest.mark.slow
@pytest.mark.parametrize("bent", LENSES[1:], ids=lambda bent: bent.model)
@pytest.mark.parametrize("edge_px", [2.0, 12.8])
def test_a_coefficient_is_known_by_how_far_it_moves_the_image(bent, edge_px):
    camera = camera_with(bent)
    sigma = coefficient_sigmas(camera, edge_px)
    pixels = np.stack(np.meshgrid(np.linspace(0, 639, 17), np.linspace(0, 479, 17)), -1).reshape(-1, 2)
    rays, shown = (np.asarray(found) for found in rays_of(camera, pixels))
    k, zero = np.array(camera.intrinsics), np.zeros(3)
    if bent.model == "omnidirectional":
        pytest.importorskip("cv2.omnidir")
    for n, step in enumerate(1e-4 * np.diag(sigma)):

        def image(values):
            if bent.model == "equidistant":
                return cv2.fisheye.projectPoints(rays[shown][None], zero, zero, k, values, alpha=0.5 / 400)[0][0]
            if bent.model == "omnidirectional":
                return cv2.omnidir.projectPoints(rays[shown][None], zero, zero, k, values[0], values[1:])[0][0]
            return cv2.projectPoints(rays[shown] / rays[shown][:, 2:], zero, zero, k, values)[0][:, 0]

        coefficients = np.array(bent.coefficients)
        moved = np.linalg.norm(image(coefficients + step) - image(coefficients - step), axis=1).max() / 2e-4
        assert moved == pytest.approx(edge_px, rel=3e-3), names(camera)[COEFFICIENTS.start + n]
