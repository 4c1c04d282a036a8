"""COLMAP's cameras.txt: `CAMERA_ID MODEL WIDTH HEIGHT PARAMS...`. Its pixel centres are at 0.5, ours at 0."""

import re

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.calibration.document import Document
from ebjax.io.calibration.kind import Kind, choose
from ebjax.io.calibration.lens import lens
from ebjax.io.calibration.values import intrinsics_from, numbers, whole

NAME = "COLMAP cameras.txt"
MODELS = {
    "SIMPLE_PINHOLE": ("pinhole", "f cx cy", 0),
    "PINHOLE": ("pinhole", "fx fy cx cy", 0),
    "SIMPLE_RADIAL": ("plumb_bob", "f cx cy k1", 4),
    "RADIAL": ("plumb_bob", "f cx cy k1 k2", 4),
    "OPENCV": ("plumb_bob", "fx fy cx cy k1 k2 p1 p2", 4),
    "FULL_OPENCV": ("rational_polynomial", "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6", 8),
    "SIMPLE_FISHEYE": ("equidistant", "f cx cy", 4),
    "FISHEYE": ("equidistant", "fx fy cx cy", 4),
    "SIMPLE_RADIAL_FISHEYE": ("equidistant", "f cx cy k1", 4),
    "RADIAL_FISHEYE": ("equidistant", "f cx cy k1 k2", 4),
    "OPENCV_FISHEYE": ("equidistant", "fx fy cx cy k1 k2 k3 k4", 4),
}
"""By COLMAP's model: the lens, the parameters, and how many coefficients; those not among the parameters are 0."""


def _lines(document: Document) -> dict[str, tuple[int, list[str]]]:
    """Fields by camera id, with the line's number."""
    found: dict[str, tuple[int, list[str]]] = {}
    for number, line in enumerate(document.text.splitlines(), start=1):
        fields = line.split()
        if len(fields) >= 4 and fields[0].isdigit() and re.fullmatch("[A-Z][A-Z0-9_]+", fields[1]):
            found.setdefault(fields[0], (number, fields))
    return found


def _recognises(document: Document) -> bool:
    lines = [line for line in document.text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    return bool(lines) and len(_lines(document)) == len(lines)


def _read(document: Document) -> Calibration:
    path, lines = document.path, _lines(document)
    name, notes = choose(path, list(lines), document.camera)
    number, (_, word, *rest) = lines[name]
    where = f"line {number}"
    if word not in MODELS:
        raise ValueError(
            f"{path} {where}: the model {word} is not read; {', '.join(MODELS)} are; undistort with COLMAP"
        )
    model, names, count = MODELS[word]
    width, height = (whole(path, f"{where}, {key}", v) for key, v in zip(("WIDTH", "HEIGHT"), rest[:2], strict=True))
    keys = names.split()
    found = dict(zip(keys, numbers(path, f"{where}, {names}", rest[2:], len(keys)), strict=True))
    focal = [found.get("fx", found.get("f")), found.get("fy", found.get("f"))]
    k = intrinsics_from(path, [f"{where}, {n}" for n in ("fx", "fy", "cx", "cy")], [*focal, found["cx"], found["cy"]])
    k[:2, 2] -= 0.5
    coefficients = list(found.values())[keys.index("cy") + 1 :]
    model, distortion = lens(path, model, [*coefficients, *[0.0] * (count - len(coefficients))])
    return Calibration(str(path), NAME, width, height, k, model, distortion, notes=notes)


KIND = Kind(NAME, _recognises, _read, several=True)
