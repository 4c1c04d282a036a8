"""How wide a camera sees, against OpenCV's projections."""

import cv2
import numpy as np
import pytest

from ebjax.io.calibration.calibration import Calibration
from ebjax.logs.field_of_view import field_of_view_deg

K = np.array([[400.0, 0, 330], [0, 410.0, 235], [0, 0, 1]])
LENSES = {
    "pinhole": (),
    "plumb_bob": (-0.25, 0.08, 0.0, 0.0, -0.01),
    "rational_polynomial": (0.4, 0.05, 0.0, 0.0, 0.01, 0.7, 0.1, 0.02),
    "equidistant": (0.03, -0.01, 0.004, -0.001),
    "omnidirectional": (1.2, -0.1, 0.02, 0.0, 0.0),
}


def pixel(model, D, angle, axis):
    ray = np.zeros((1, 1, 3))
    ray[0, 0, axis], ray[0, 0, 2] = np.sin(angle), np.cos(angle)
    zero = np.zeros(3)
    if model == "equidistant":
        return cv2.fisheye.projectPoints(ray, zero, zero, K, np.array(D))[0][0, 0, axis]
    if model == "omnidirectional":
        ray[0, 0, 2] += D[0]
        D = D[1:]
    return cv2.projectPoints(ray, zero, zero, K, np.array(D, np.float64))[0][0, 0, axis]


@pytest.mark.parametrize("model", LENSES)
def test_edges_are_where_opencv_puts_them(model):
    D = LENSES[model]
    seen = field_of_view_deg(Calibration("here", "made", 640, 480, K, model, D))
    for axis, size in ((0, 640), (1, 480)):
        low, high = (
            next(a for a in np.deg2rad(np.arange(0.1, 130, 0.1)) if beyond(pixel(model, D, sign * a, axis), size))
            for sign, beyond in ((-1, lambda p, size: p < -0.5), (1, lambda p, size: p > size - 0.5))
        )
        assert seen[axis] == pytest.approx(np.rad2deg(low + high), abs=0.3)


def test_a_lens_that_folds_back_ends_there():
    across, _ = field_of_view_deg(Calibration("here", "made", 640, 480, K, "plumb_bob", (-0.5, 0.0, 0.0, 0.0)))
    fold = 2 * np.rad2deg(np.arctan(np.sqrt(1 / 1.5)))  # r (1 - r^2 / 2) rises up to there
    assert across == pytest.approx(fold, abs=0.2)
