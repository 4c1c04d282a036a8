"""ebjax's own camera.json, as a calibration."""

from pathlib import Path

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.calibration.document import Document
from ebjax.io.calibration.kind import Kind
from ebjax.io.camera_file import KEYS, CameraFile, read_camera


def _recognises(document: Document) -> bool:
    """By the mount's key, which is ebjax's alone, or by most of the others."""
    own = [key for key in KEYS if key in document.values]
    return "T_base_camera" in own or (len(own) >= 4 and bool({"fx", "fy"} & set(own)))


def _read(document: Document) -> Calibration:
    path = document.path
    depth = "depth_scale" in document.values
    camera = read_camera(path, depth=depth)
    return calibration_from_camera(path, camera, camera.depth_scale if depth else None)


def calibration_from_camera(path: Path, camera: CameraFile, depth_scale: float | None) -> Calibration:
    """What a camera.json says, as a calibration."""
    return Calibration(
        source=str(path),
        kind="camera.json",
        width=camera.width,
        height=camera.height,
        intrinsics=camera.intrinsics,
        distortion_model=camera.distortion_model,
        distortion=camera.distortion,
        base_from_camera=camera.base_from_camera,
        depth_scale=depth_scale,
    )


KIND = Kind("camera.json of ebjax", _recognises, _read)
