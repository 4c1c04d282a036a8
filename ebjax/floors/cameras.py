"""Forward cameras by name: the paper's robot and phone, and a GoPro, without lens distortion.

p3dx-d435 is the authors' robot: a RealSense D435 at 640 x 480 on a Pioneer P3DX. phone is theirs too: 1920 x 1080, its
pitch from the vanishing point of the quad they picked by hand ([544, 649], [1379, 646], [1602, 1049], [300, 1045]: the
horizon is 63 px above the image), held at chest height. gopro has the linear field of view, 86 degrees across.
"""

import dataclasses
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ebjax.geometry.camera import Camera, camera_over_floor


class Model(NamedTuple):
    """A camera and how it is usually carried: px, m, degrees."""

    width: int
    height: int
    focal_px: float
    centre_px: tuple[float, float]
    height_m: float
    x_m: float
    pitch_deg: float


MODELS = {
    "p3dx-d435": Model(640, 480, 617.19, (314.65, 246.58), 0.54, 0.27, 19.0),
    "phone": Model(1920, 1080, 1500.0, (959.5, 539.5), 1.2, 0.1, 21.9),
    "gopro": Model(1920, 1080, 1029.0, (959.5, 539.5), 0.9, 0.1, 25.0),
}
ModelName = Literal["p3dx-d435", "phone", "gopro"]


@dataclasses.dataclass(frozen=True)
class CameraConfig:
    """The camera on the robot."""

    model: ModelName = "p3dx-d435"
    """p3dx-d435 (640 x 480), phone (1920 x 1080) or gopro (1920 x 1080, wide)."""
    width: int | None = None
    """Image width to which everything is scaled, px; None: the model's own."""
    height_m: float | None = None
    """Above the floor, m; None: the model's own."""
    x_m: float | None = None
    """Ahead of the wheels' axis, m; None: the model's own."""
    pitch_deg: float | None = None
    """Downward tilt, degrees; None: the model's own."""


def carried(config: CameraConfig) -> Model:
    """The model as it is carried and scaled here."""
    model = MODELS[config.model]
    scale = 1.0 if config.width is None else config.width / model.width
    # Pixel centres are at integers: it is the image's edge at -1/2 that stays.
    cx, cy = ((c + 0.5) * scale - 0.5 for c in model.centre_px)
    own = {name: value for name in ("height_m", "x_m", "pitch_deg") if (value := getattr(config, name)) is not None}
    width, height = round(model.width * scale), round(model.height * scale)
    return model._replace(width=width, height=height, focal_px=model.focal_px * scale, centre_px=(cx, cy), **own)


def check(config: CameraConfig) -> None:
    """Raises ValueError that names the key which no camera can have."""
    if config.width is not None and not config.width >= 16:
        raise ValueError(f"camera.width is {config.width}: needs at least 16")
    if not 0.02 <= carried(config).height_m < 2.5:
        raise ValueError(f"camera.height_m is {config.height_m}: needs a value from 0.02 to below the ceiling (2.5)")
    if not -45 <= carried(config).pitch_deg <= 90:
        raise ValueError(f"camera.pitch_deg is {config.pitch_deg}: needs a value from -45 to 90")


def make_camera(config: CameraConfig) -> Camera:
    """The camera in float32."""
    model = carried(config)
    numbers = (model.focal_px, model.focal_px, *model.centre_px)
    camera = camera_over_floor(
        *numbers, model.width, model.height, model.height_m, float(np.radians(model.pitch_deg)), x_m=model.x_m
    )
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), camera)
