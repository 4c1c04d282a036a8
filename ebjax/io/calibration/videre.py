"""The Videre INI of ROS's camera_calibration: sections [image] and the camera's name, values under their headings."""

import re

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.calibration.document import Document
from ebjax.io.calibration.kind import Kind
from ebjax.io.calibration.lens import unnamed_lens
from ebjax.io.calibration.values import camera_matrix, member, numbers, whole

NAME = "Videre INI"
HEADINGS = ("width", "height", "camera matrix", "distortion", "rectification", "projection")


def _recognises(document: Document) -> bool:
    heads = re.findall(r"(?im)^[ \t]*(\[image\]|camera matrix|distortion|projection)[ \t\r]*$", document.text)
    return len({head.lower() for head in heads}) >= 2


def _fields(document: Document) -> dict[str, list[str]]:
    """The words under each heading."""
    found: dict[str, list[str]] = {}
    words: list[str] = []
    for line in re.sub("[#;].*", "", document.text).splitlines():
        heading = line.strip().lower()
        if heading in found:
            raise ValueError(f"{document.path}: {heading!r} is there twice; give a file of one camera")
        if heading in HEADINGS:
            words = found.setdefault(heading, [])
        elif heading.startswith("["):
            words = []
        else:
            words += line.split()
    return {heading: words for heading, words in found.items() if words}


def _read(document: Document) -> Calibration:
    path, found = document.path, _fields(document)
    width, height = (whole(path, side, " ".join(member(path, found, side)[1])) for side in ("width", "height"))
    k = camera_matrix(path, *member(path, found, "camera matrix"))
    model, distortion, notes = unnamed_lens(path, numbers(path, *member(path, found, "distortion")))
    return Calibration(str(path), NAME, width, height, k, model, distortion, notes=notes)


KIND = Kind(NAME, _recognises, _read)
