import cv2
import numpy as np
import pytest

from ebjax.viz import experiments


def pixels(png):
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None and image.std() > 1
    return image


def test_images_lie_in_their_cells():
    red, blue = (np.full((20, 30, 3), colour, np.uint8) for colour in ((255, 0, 0), (0, 0, 255)))
    image = pixels(experiments.image_grid({"a": (red, blue), "b": (blue, red)}, ("one", "two")))
    left, right = image[:, : image.shape[1] // 2], image[:, image.shape[1] // 2 :]
    for half in (left, right):
        is_red, is_blue = (np.all(half == colour, -1) for colour in ((0, 0, 255), (255, 0, 0)))
        assert is_red.sum() > 500 < is_blue.sum()
    assert np.argmax(np.all(left == (0, 0, 255), -1).any(1)) < np.argmax(np.all(left == (255, 0, 0), -1).any(1))


def test_curves_and_maps_are_drawn():
    curve = np.array([0.0, 0.5, 1.0]), np.array([1.0, 0.9, 0.4])
    pixels(experiments.precision_over_recall({f"D{k}": {"raw": curve, "floor + pi": curve} for k in range(5)}))
    floor = np.full((10, 40, 4), 128, np.uint8)
    pixels(experiments.maps({"odometry": (floor, (0.0, 4.0, 0.0, 1.0)), "ours": (floor, (0.0, 4.0, 0.5, 1.5))}))


@pytest.mark.parametrize("values", [("0", "0.4", "0.8"), ("marble", "wood", "1 designs")])
def test_settings_are_numbers_or_names(values):
    points = dict(zip(values, (0.9, None, 0.5), strict=True))
    pixels(experiments.over_setting({"R@1 m": {"": points}, "ATE": {"none": points, "dcs": points}}, "s", log=("ATE",)))
