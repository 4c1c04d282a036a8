"""A camera matrix and coefficients as programs around OpenCV save them: FileStorage's YAML, XML or JSON, or a dump."""

import re
from typing import Any

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.calibration.document import Document
from ebjax.io.calibration.kind import Kind, choose
from ebjax.io.calibration.lens import lens, unnamed_lens
from ebjax.io.calibration.values import camera_matrix, image_size, numbers

NAME = "OpenCV YAML, XML or JSON"
MATRIX = re.compile(r"(cameramatrix|cammatrix|intrinsicmatrix|intrinsics?|kmatrix|k|m|mtx)(\d*|left|right|l|r)")
LENS = re.compile(
    r"(distortioncoefficients|distortioncoeffs?|distortioncoefs?|distcoeffs?|distcoefs?|distcoefficients|distortion"
    r"|dist|d)(\d*|left|right|l|r)"
)
SIZES = [
    ("image_width", "image_height"), ("image_Width", "image_Height"), ("imageWidth", "imageHeight"),
    ("width", "height"), ("Width", "Height"), ("w", "h"),
    ("image_size",), ("imageSize",), ("ImageSize",), ("img_size",), ("size",), ("resolution",),
]  # fmt: skip
MODELS = ("distortion_model", "camera_model", "model", "camera_type", "model_type")
FISHEYE = ("fisheye_model", "fisheye", "is_fisheye", "use_fisheye")


def _cameras(values: dict[str, Any], form: re.Pattern[str]) -> dict[str, str]:
    """The keys of that form by the camera's name: "" where there is only one, else 1, 2, left, r, ..."""
    listed = [key for key, value in values.items() if isinstance(value, list | dict) or len(str(value).split()) >= 4]
    plain = {re.sub(r"[\s_-]", "", key.lower()): key for key in listed}
    return {match[2]: key for name, key in plain.items() if (match := form.fullmatch(name))}


def _recognises(document: Document) -> bool:
    values = document.values
    sized = any(all(name in values for name in names) for names in SIZES)
    return bool(_cameras(values, MATRIX)) or (sized and bool(_cameras(values, LENS)))


def _lens_name(values: dict[str, Any]) -> str:
    """The lens's name, or "" where the file does not say."""
    for key in FISHEYE:
        if key in values:
            return "plumb_bob" if str(values[key]).lower() in ("0", "0.0", "false", "no") else "fisheye"
    words = [str(values[key]) for key in MODELS if key in values]
    return words[0] if words and words[0].lower() != "pinhole" else ""


def _read(document: Document) -> Calibration:
    path, values = document.path, document.values
    matrices, lenses = _cameras(values, MATRIX), _cameras(values, LENS)
    if not matrices:
        raise ValueError(f"{path}: no key 'camera_matrix'; add it, or give the whole calibration file")
    name, notes = choose(path, list(matrices), document.camera)
    key = matrices[name]
    k = camera_matrix(path, key, values[key])
    if name not in lenses:
        wanted = f"D{name}" if name else "distortion_coefficients"
        raise ValueError(f"{path}: no key {wanted!r} beside {key!r}; add it, with zeros where the image is rectified")
    coefficients = numbers(path, lenses[name], values[lenses[name]])
    if word := _lens_name(values):
        model, distortion = lens(path, word, coefficients)
    else:
        model, distortion, said = unnamed_lens(path, coefficients)
        notes += said
    (width, height), said = image_size(path, values, SIZES, document.size)
    return Calibration(str(path), NAME, width, height, k, model, distortion, notes=(*notes, *said))


KIND = Kind(NAME, _recognises, _read, several=True)
