"""A lens profile of Gyroflow: OpenCV's fisheye (or its standard lens) at the size of calib_dimension."""

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.calibration.document import Document
from ebjax.io.calibration.kind import Kind
from ebjax.io.calibration.lens import lens
from ebjax.io.calibration.values import camera_matrix, member, number, numbers, section, shown, whole

NAME = "Gyroflow lens profile"


def _read(document: Document) -> Calibration:
    path, values = document.path, document.values
    word = shown(values.get("distortion_model") or "opencv_fisheye")
    if values.get("use_opencv_standard") is True:
        word = "opencv_standard"
    if values.get("digital_lens"):
        raise ValueError(f"{path}: digital_lens {values['digital_lens']!r} is not read; give a profile without one")
    if number(path, "input_horizontal_stretch", values.get("input_horizontal_stretch") or 1.0) != 1.0:
        raise ValueError(f"{path}: the profile is of a stretched image (input_horizontal_stretch); that is not read")
    part = "calib_params" if word == "opencv_standard" and values.get("calib_params") else "fisheye_params"
    prefix, found = f"{part}.", section(path, values, part)
    k = camera_matrix(path, *member(path, found, "camera_matrix", prefix=prefix))
    coefficients = numbers(path, *member(path, found, "distortion_coeffs", prefix=prefix))
    model, distortion = lens(path, word, coefficients)
    size = section(path, values, "calib_dimension")
    width, height = (whole(path, *member(path, size, side, prefix="calib_dimension.")) for side in ("w", "h"))
    return Calibration(str(path), NAME, width, height, k, model, distortion)


KIND = Kind(NAME, lambda document: bool({"fisheye_params", "calib_dimension"} & set(document.values)), _read)
