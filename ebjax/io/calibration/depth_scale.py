"""How many units of a depth image a metre has, by the calibration files that say it."""

import math
from pathlib import Path

from ebjax.io.calibration.document import open_document

KEYS = ("depth_scale", "DepthMapFactor", "RGBD.DepthMapFactor")
"""Of camera.json, and of ORB-SLAM's settings."""


def depth_scale_in(path: str | Path) -> float | None:
    """Depth units per metre, or None where the file says nothing; its readers check the rest of it."""
    values = open_document(path).values
    given = [values[key] for key in KEYS if isinstance(values.get(key), int | float)]
    return next((float(value) for value in given if math.isfinite(value) and value > 0), None)
