"""Forward cameras by name: the paper's robot and phone, and a GoPro; or any camera that a calibration describes.

p3dx-d435 is the authors' robot: a RealSense D435 at 640 x 480 on a Pioneer P3DX. phone is theirs too: 1920 x 1080, its
pitch from the vanishing point of the quad they picked by hand ([544, 649], [1379, 646], [1602, 1049], [300, 1045]: the
horizon is 63 px above the image), held at chest height. gopro has the linear field of view, 86 degrees across. These
are without lens distortion. phone-raw is the phone as its lens leaves the image; gopro-wide is a GoPro's fisheye at
1280 x 960, 120 degrees across.
"""

import dataclasses
import typing
from pathlib import Path
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ebjax.geometry.camera import Camera, camera_over_floor
from ebjax.geometry.lens import lens
from ebjax.geometry.lens_models import lens_fault, no_lens_if_straight


class Model(NamedTuple):
    """A camera and how it is usually carried: px, m, degrees."""

    width: int
    height: int
    focal_px: float
    centre_px: tuple[float, float]
    height_m: float
    x_m: float
    pitch_deg: float
    distortion_model: str = "pinhole"
    distortion: tuple[float, ...] = ()


PHONE_LENS = ("plumb_bob", (0.15, -0.3, 0.0008, -0.0006, 0.16))
GOPRO_LENS = ("equidistant", (0.045, 0.012, -0.02, 0.006))
MODELS = {
    "p3dx-d435": Model(640, 480, 617.19, (314.65, 246.58), 0.54, 0.27, 19.0),
    "phone": Model(1920, 1080, 1500.0, (959.5, 539.5), 1.2, 0.1, 21.9),
    "gopro": Model(1920, 1080, 1029.0, (959.5, 539.5), 0.9, 0.1, 25.0),
    "phone-raw": Model(1920, 1080, 1500.0, (959.5, 539.5), 1.2, 0.1, 21.9, *PHONE_LENS),
    "gopro-wide": Model(1280, 960, 584.0, (639.5, 479.5), 0.9, 0.1, 25.0, *GOPRO_LENS),
}
ModelName = Literal["p3dx-d435", "phone", "gopro", "phone-raw", "gopro-wide"]
LensName = Literal["pinhole", "plumb_bob", "rational_polynomial", "equidistant", "omnidirectional"]
MOUNT = ("height_m", "x_m", "pitch_deg")


@dataclasses.dataclass(frozen=True)
class CameraConfig:
    """The camera on the robot."""

    model: ModelName = "p3dx-d435"
    """p3dx-d435 (640 x 480), phone (1920 x 1080) or gopro (1920 x 1080, wide), all without distortion; phone-raw (as
    phone, through its lens) or gopro-wide (1280 x 960, a fisheye)."""
    width: int | None = None
    """Image width to which everything is scaled, px; None: the model's own, or the file's."""
    height_m: float | None = None
    """Above the floor, m; None: the model's own."""
    x_m: float | None = None
    """Ahead of the wheels' axis, m; None: the model's own."""
    pitch_deg: float | None = None
    """Downward tilt, degrees; None: the model's own."""
    file: Path | None = None
    """Calibration of any known kind: its intrinsics, image size and lens in place of the model's, and its mount too if
    it has one."""
    distortion_model: LensName | None = None
    """Lens in place of the model's; None: the model's own, or the file's."""
    distortion: tuple[float, ...] = ()
    """Coefficients of that lens in OpenCV's order: k1 k2 p1 p2 k3, equidistant k1 k2 k3 k4, omnidirectional xi k1 k2 p1
    p2."""


@typing.runtime_checkable
class CalibrationValues(typing.Protocol):
    """What is used of a calibration file: `io.calibration.calibration.Calibration` has it."""

    @property
    def width(self) -> int:
        """In pixels."""

    @property
    def height(self) -> int:
        """In pixels."""

    @property
    def intrinsics(self) -> Float[np.ndarray, "3 3"]:
        """K, px."""

    @property
    def distortion_model(self) -> str:
        """Of its lens."""

    @property
    def distortion(self) -> tuple[float, ...]:
        """Coefficients."""

    @property
    def base_from_camera(self) -> Float[np.ndarray, "4 4"] | None:
        """Its mount, m; None where the file says nothing of it."""


def carried(config: CameraConfig) -> Model:
    """The model as it is carried and scaled here."""
    model = MODELS[config.model]
    scale = 1.0 if config.width is None else config.width / model.width
    # Pixel centres are at integers: it is the image's edge at -1/2 that stays.
    cx, cy = ((c + 0.5) * scale - 0.5 for c in model.centre_px)
    own = {name: value for name in MOUNT if (value := getattr(config, name)) is not None}
    if config.distortion_model is not None:
        own |= dict(zip(("distortion_model", "distortion"), _own_lens(config), strict=True))
    width, height = round(model.width * scale), round(model.height * scale)
    return model._replace(width=width, height=height, focal_px=model.focal_px * scale, centre_px=(cx, cy), **own)


def _own_lens(config: CameraConfig) -> tuple[str, tuple[float, ...]]:
    return no_lens_if_straight(config.distortion_model or "pinhole", config.distortion)


def position(config: CameraConfig, calibration: CalibrationValues | None = None) -> Float[np.ndarray, "3"]:
    """Of the camera in base, m."""
    if calibration is not None and calibration.base_from_camera is not None:
        return np.asarray(calibration.base_from_camera[:3, 3], np.float64)
    model = carried(config)
    return np.array([model.x_m, 0.0, model.height_m])


def check(config: CameraConfig, calibration: CalibrationValues | None = None) -> None:
    """Raises ValueError that names the key which no camera can have.

    Args:
      config: the camera.
      calibration: what is in `config.file`; None where that is not read yet.
    """
    if config.width is not None and not config.width >= 16:
        raise ValueError(f"camera.width is {config.width}: needs at least 16")
    if config.distortion and config.distortion_model is None:
        raise ValueError(f"camera.distortion is {config.distortion}: needs camera.distortion_model")
    if config.distortion_model is not None:
        if config.file is not None:
            raise ValueError(
                f"camera.distortion_model is {config.distortion_model!r}: the lens is that of camera.file; leave it out"
            )
        if fault := lens_fault(config.distortion_model, config.distortion):
            raise ValueError(f"camera.distortion is {config.distortion}: {fault}")
    if calibration is not None and calibration.base_from_camera is not None:
        for name in MOUNT:
            if getattr(config, name) is not None:
                raise ValueError(
                    f"camera.{name} is {getattr(config, name)}: the mount is that of camera.file; leave it out"
                )
        if not 0.02 <= (height_m := position(config, calibration)[2]) < 2.5:
            raise ValueError(
                f"camera.file is {config.file}: its camera is {height_m:g} m above the floor; needs a value from 0.02 "
                "to below the ceiling (2.5)"
            )
    if not 0.02 <= carried(config).height_m < 2.5:
        raise ValueError(f"camera.height_m is {config.height_m}: needs a value from 0.02 to below the ceiling (2.5)")
    if not -45 <= carried(config).pitch_deg <= 90:
        raise ValueError(f"camera.pitch_deg is {config.pitch_deg}: needs a value from -45 to 90")


def make_camera(config: CameraConfig, calibration: CalibrationValues | None = None) -> Camera:
    """The camera in float32, with the intrinsics, size, lens and mount of a calibration where there is one."""
    model = carried(config)
    numbers: tuple[float, ...] = (model.focal_px, model.focal_px, *model.centre_px)
    size = model.width, model.height
    bent = lens(model.distortion_model, model.distortion)
    if calibration is not None:
        k, width = calibration.intrinsics, config.width or calibration.width
        scale = width / calibration.width
        numbers = *(float(k[i, i]) * scale for i in (0, 1)), *((float(k[i, 2]) + 0.5) * scale - 0.5 for i in (0, 1))
        size = width, round(calibration.height * scale)
        bent = lens(calibration.distortion_model, calibration.distortion)
    pitch_rad = float(np.radians(model.pitch_deg))
    fx, fy, cx, cy = numbers
    camera = camera_over_floor(fx, fy, cx, cy, *size, model.height_m, pitch_rad, x_m=model.x_m)
    camera = dataclasses.replace(camera, lens=bent)
    if calibration is not None and calibration.base_from_camera is not None:
        camera = dataclasses.replace(camera, base_from_camera=calibration.base_from_camera)
    return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf, np.float32)), camera)
