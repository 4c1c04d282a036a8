"""The camera YAML of VINS-Mono, VINS-Fusion and camodocal: model_type, projection_parameters, ..."""

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.calibration.document import Document
from ebjax.io.calibration.kind import Kind
from ebjax.io.calibration.lens import lens
from ebjax.io.calibration.values import image_size, intrinsics_from, member, number, section, shown

NAME = "VINS or camodocal YAML"
PROJECTION = {
    "PINHOLE": ("plumb_bob", ("fx", "fy", "cx", "cy"), ("k1", "k2", "p1", "p2")),
    "PINHOLE_FULL": ("rational_polynomial", ("fx", "fy", "cx", "cy"), ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    "KANNALA_BRANDT": ("equidistant", ("mu", "mv", "u0", "v0"), ("k2", "k3", "k4", "k5")),
    "MEI": ("omnidirectional", ("gamma1", "gamma2", "u0", "v0"), ("xi", "k1", "k2", "p1", "p2")),
}
"""By model_type: the lens, the keys of fx fy cx cy, the keys of its coefficients."""
PARTS = ("mirror_parameters", "distortion_parameters", "projection_parameters")


def _read(document: Document) -> Calibration:
    path, values = document.path, document.values
    word = shown(member(path, values, "model_type")[1]).upper()
    if word not in PROJECTION:
        raise ValueError(f"{path}: model_type {word!r} is not read; {', '.join(PROJECTION)} are")
    model, keys, order = PROJECTION[word]
    found = {key: value for part in PARTS for key, value in section(path, values, part).items()}
    k = intrinsics_from(path, keys, [member(path, found, key)[1] for key in keys])
    coefficients = [number(path, *member(path, found, key)) for key in order]
    model, distortion = lens(path, model, coefficients)
    (width, height), notes = image_size(path, values, [("image_width", "image_height")], document.size)
    return Calibration(str(path), NAME, width, height, k, model, distortion, notes=notes)


KIND = Kind(NAME, lambda document: {"model_type", "projection_parameters"} <= set(document.values), _read)
