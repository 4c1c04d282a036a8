"""How wide a camera sees, its lens included."""

import numpy as np
from jaxtyping import Float

from ebjax.io.calibration.calibration import Calibration

ANGLES = np.linspace(0, np.pi, 7201)


def field_of_view_deg(camera: Calibration) -> tuple[float, float]:
    """Across and down the middle of the image, from edge to edge, degrees.

    Tangential and thin-prism terms of the lens are left out. What lies beyond where the lens folds back is not seen.
    """
    angles, radii = _radii(camera.distortion_model, camera.distortion)
    across, down = (
        (camera.intrinsics[axis, 2] + 0.5, size - 0.5 - camera.intrinsics[axis, 2], camera.intrinsics[axis, axis])
        for axis, size in ((0, camera.width), (1, camera.height))
    )
    both = (sum(np.interp([low / focal, high / focal], radii, angles)) for low, high, focal in (across, down))
    width, height = (float(np.rad2deg(angle)) for angle in both)
    return width, height


def _radii(model: str, k: tuple[float, ...]) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """Angles from the optical axis, and how far from it a lens shows them on the normalised plane, while that rises."""
    if model == "equidistant":
        radii = ANGLES * (1 + sum(c * ANGLES ** (2 * power) for power, c in enumerate(k, 1)))
    else:
        xi, k = (k[0], k[1:]) if model == "omnidirectional" else (0.0, k)
        depth = np.cos(ANGLES) + xi
        radii = np.where(depth > 1e-6, np.sin(ANGLES) / np.maximum(depth, 1e-6), -1)
        k1, k2, _, _, k3, k4, k5, k6 = (*k, *[0.0] * 8)[:8]
        square = radii**2
        radii = radii * (1 + square * (k1 + square * (k2 + square * k3)))
        radii = radii / (1 + square * (k4 + square * (k5 + square * k6)))
    falls = np.flatnonzero(~(np.diff(radii) > 0))
    end = falls[0] + 1 if len(falls) else len(radii)
    return ANGLES[:end], radii[:end]
