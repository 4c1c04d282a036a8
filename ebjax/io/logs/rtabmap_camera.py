"""Which camera of an RTAB-Map database is used, and as what: rectified or raw."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from ebjax.io.calibration.calibration import Calibration, implausible
from ebjax.io.logs.rtabmap_calibration import DatabaseCamera

FISHEYE_NUMBERS = 6
LEAST_HEIGHT_M = 0.02


def floor_distance_m(camera: DatabaseCamera) -> float:
    """How far along the optical axis the floor (z = 0 of base_link) lies; infinite where the axis misses it."""
    mount = camera.base_from_camera
    if mount is None or mount[2, 2] >= 0 or mount[2, 3] <= 0:
        return float("inf")
    return float(-mount[2, 3] / mount[2, 2])


def pitch_deg(mount: Float[np.ndarray, "4 4"]) -> float:
    """How far below the horizon the optical axis points, degrees."""
    return float(np.rad2deg(np.arcsin(np.clip(-mount[2, 2], -1, 1))))


def described(camera: DatabaseCamera) -> str:
    """The camera in words: size, focal length, and where it sits."""
    k, mount = camera.rectified, camera.base_from_camera
    if k is None:
        return "no calibration"
    words = f"{camera.width} x {camera.height} px, fx {k[0, 0]:.1f} px{', left of a stereo pair' * camera.stereo}"
    if mount is None:
        return f"{words}, mount unknown"
    return f"{words}, {mount[2, 3]:.2f} m over base_link, looks {pitch_deg(mount):.1f} degrees below the horizon"


def chosen_camera(path: Path, cameras: Sequence[DatabaseCamera], index: int | None) -> tuple[int, list[str]]:
    """Chooses among cameras side by side: the given one, else the one whose optical axis meets the floor nearest.

    Where no axis meets the floor, the one that looks down most; of equals, the one that looks ahead most.

    Raises:
      ValueError: there is no such camera.
    """
    if index is not None and not 0 <= index < len(cameras):
        raise ValueError(f"{path}: no camera {index}; its images hold {len(cameras)}, give 0 to {len(cameras) - 1}")
    if index is not None or len(cameras) == 1:
        return index or 0, []

    def order(number: int) -> tuple[float, float, float]:
        mount = cameras[number].base_from_camera
        if mount is None:
            return float("inf"), float("inf"), float("inf")
        return round(floor_distance_m(cameras[number]), 2), round(float(mount[2, 2]), 2), -float(mount[0, 2])

    chosen = min(range(len(cameras)), key=order)
    distance = floor_distance_m(cameras[chosen])
    why = f"its axis meets the floor nearest, at {distance:.2f} m" if np.isfinite(distance) else "it looks down most"
    return chosen, [f"{path}: camera {chosen} of {len(cameras)} is used, {why}; camera_index chooses another"]


def calibration_from_camera(
    path: Path, camera: DatabaseCamera, images: Literal["rectified", "raw"]
) -> tuple[Calibration | None, list[str]]:
    """The camera of the images as stored, with notes; None where the database has no intrinsics.

    "rectified" takes P (else K) and a pinhole, as RTAB-Map does (Rtabmap/ImagesAlreadyRectified); "raw" takes K and D.
    """
    raw = images == "raw" and camera.raw is not None
    k = camera.raw if raw else camera.rectified
    if k is None or not np.isfinite(k).all() or k[0, 0] <= 0 or k[1, 1] <= 0:
        return None, [f"{path}: its camera has no valid intrinsics"]
    bent = raw and any(camera.distortion)
    model, distortion = lens_from_coefficients(camera.distortion) if bent else ("pinhole", ())
    notes = []
    if images == "raw" and camera.raw is None:
        notes = [f"{path}: has no K and D of the raw image; its images are used as rectified"]
    if images == "rectified" and camera.looks_raw:
        notes = [
            f"{path}: its lens bends (D is not 0) but P is K and R the identity: the stored images are probably not "
            "rectified. They are used as rectified, as RTAB-Map does; --images raw uses K and D"
        ]
    if camera.base_from_camera is not None and camera.base_from_camera[2, 3] <= LEAST_HEIGHT_M:
        height = f"{camera.base_from_camera[2, 3]:.2f} m over base_link"
        notes.append(f"{path}: the camera sits {height}: base_link is not on the floor; give the mount over the floor")
    found = Calibration(
        source=str(path),
        kind="RTAB-Map database",
        width=camera.width,
        height=camera.height,
        intrinsics=k,
        distortion_model=model,
        distortion=distortion,
        base_from_camera=camera.base_from_camera,
    )
    if camera.width and (fault := implausible(found)):
        return None, [f"{path}: its camera has no valid intrinsics: {fault}"]
    return found, notes


def lens_from_coefficients(d: tuple[float, ...]) -> tuple[str, tuple[float, ...]]:
    """Names the lens by RTAB-Map's number of coefficients: 6 are a fisheye's, else OpenCV's order."""
    if len(d) == FISHEYE_NUMBERS:
        return "equidistant", (d[0], d[1], d[4], d[5])
    return ("plumb_bob" if len(d) <= 5 else "rational_polynomial"), d
