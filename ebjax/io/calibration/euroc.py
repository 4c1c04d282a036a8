"""The sensor.yaml of EuRoC and Kimera. T_BS is IMU from camera, not the mount.

Kimera's omni lens is a polynomial of Scaramuzza: a pixel at radius r sees along (r, a0 + a1 r + ... + a4 r^4).
"""

import numpy as np

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.calibration.document import Document
from ebjax.io.calibration.kalibr import projected
from ebjax.io.calibration.kind import Kind
from ebjax.io.calibration.lens import plain_name
from ebjax.io.calibration.values import image_size, member, numbers

NAME = "EuRoC or Kimera sensor YAML"
MOST_MISFIT_PX = 0.5


def _recognises(document: Document) -> bool:
    values = document.values
    return "T_BS" in values or "sensor_type" in values or {"camera_model", "intrinsics"} <= set(values)


def _read(document: Document) -> Calibration:
    path, values = document.path, document.values
    sensor = plain_name(values.get("sensor_type", "camera"))
    if sensor not in ("camera", "pinhole"):
        raise ValueError(f"{path}: of a sensor {sensor!r}; give the sensor.yaml of a camera")
    if "omni_distortion_center" in values or plain_name(values.get("distortion_model", "")) == "omni":
        return _omni(document)
    return projected(path, NAME, values, document.size)


def _omni(document: Document) -> Calibration:
    """Fits k1 .. k4 of an equidistant lens over the angles the image sees, least squares, linear."""
    path, values = document.path, document.values
    (width, height), notes = image_size(path, values, [("resolution",)], document.size)
    polynomial = numbers(path, *member(path, values, "distortion_coefficients"), 5)
    centre = np.array(numbers(path, *member(path, values, "omni_distortion_center"), 2))
    c, d, e = numbers(path, "omni_affine", values.get("omni_affine", [0, 0, 1]), 3)
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]]) - centre
    radius = np.linspace(1, np.linalg.norm(corners, axis=1).max(), 500)
    angle = np.arctan2(radius, np.polyval(polynomial[::-1], radius))
    if c or d or e <= 0 or polynomial[0] <= 0 or (np.diff(angle) <= 0).any():
        raise ValueError(f"{path}: this polynomial lens is not read; calibrate again with Kalibr's omni-radtan")
    powers = angle[:, None] ** np.array([1, 3, 5, 7, 9])
    fitted = np.linalg.lstsq(powers, radius, rcond=None)[0]
    misfit = np.abs(powers @ fitted - radius).max()
    if misfit > MOST_MISFIT_PX or fitted[0] <= 0:
        raise ValueError(
            f"{path}: an equidistant lens fits this polynomial to {misfit:.1f} px only; calibrate again with Kalibr"
        )
    notes += (
        f"{path}: the polynomial lens is read as the equidistant one that fits it to {misfit:.2g} px",
        f"{path}: T_BS not used: not the camera's place on the robot's base",
    )
    k = np.array([[fitted[0], 0.0, centre[0]], [0.0, fitted[0] * e, centre[1]], [0.0, 0.0, 1.0]])
    distortion = tuple((fitted[1:] / fitted[0]).tolist())
    return Calibration(str(path), NAME, width, height, k, "equidistant", distortion, notes=notes)


KIND = Kind(NAME, _recognises, _read)
