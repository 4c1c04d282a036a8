"""Names and coefficients of lenses as files write them, turned into those of `geometry.lens_models`."""

import re
from collections.abc import Sequence
from pathlib import Path

from ebjax.geometry.lens_models import lens_fault, no_lens_if_straight

NAMES = {
    "pinhole": "none no undistorted rectified pinhole ideal",
    "plumb_bob": "plumb_bob plumbbob radtan rad_tan radial_tangential brown_conrady brown opencv standard "
    "opencv_standard perspective",
    "rational_polynomial": "rational_polynomial rational rational_model full_opencv",
    "equidistant": "equidistant equi fisheye opencv_fisheye kannala_brandt kannala_brandt4 kannala_brandt8 "
    "kannalabrandt kannalabrandt4 kannalabrandt8 kb4",
    "omnidirectional": "omnidirectional mei omni_radtan",
}
KNOWN = {word: model for model, words in NAMES.items() for word in words.split()}


def plain_name(name: object) -> str:
    """A lens's name in lower case with underscores, without an enumeration's prefix: RS2_DISTORTION_NONE -> none."""
    return re.sub(r"[\s-]+", "_", re.sub(r"^.*distortion[._]", "", str(name).strip().lower()))


def lens(path: Path, name: object, coefficients: Sequence[float]) -> tuple[str, tuple[float, ...]]:
    """The model and its coefficients; a lens that bends nothing becomes a pinhole.

    An equidistant lens keeps its coefficients of zero: that is the ideal fisheye r = f theta.

    Raises:
      ValueError: a lens that is not read, or a count of coefficients that it cannot have; names both.
    """
    values = tuple(float(value) for value in coefficients)
    model = KNOWN.get(plain_name(name))
    if model is None:
        raise ValueError(
            f"{path}: lenses of the kind {str(name)[:40]!r} are not read; calibrate again with one of plumb_bob, "
            "rational_polynomial, equidistant, omnidirectional"
        )
    if model == "equidistant" and not any(values[4:]):
        values = values[:4]
    model, values = no_lens_if_straight(model, values)
    if model == "pinhole" and values:
        raise ValueError(f"{path}: a lens {name!r} with coefficients that are not zero; name the lens they belong to")
    if model in ("plumb_bob", "rational_polynomial"):
        model = "plumb_bob" if len(values) < 8 else "rational_polynomial"
    if fault := lens_fault(model, values):
        raise ValueError(f"{path}: {fault}; correct the coefficients or the lens's name")
    return model, values


def unnamed_lens(path: Path, coefficients: Sequence[float]) -> tuple[str, tuple[float, ...], tuple[str, ...]]:
    """A lens of which only the coefficients are known: OpenCV's own model; four of them could be a fisheye's."""
    model, values = lens(path, "plumb_bob", coefficients)
    note = f"{path}: 4 coefficients and no name of a lens; taken as k1 k2 p1 p2 of plumb_bob, not as a fisheye's"
    return model, values, (note,) if len(values) == 4 else ()
