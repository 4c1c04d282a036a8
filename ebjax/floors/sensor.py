"""What a camera makes of radiance and depth: exposure, vignetting, noise, gamma; a D435's depth noise and holes."""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key, UInt8, UInt16

from ebjax.geometry.camera import Camera

GAMMA = 2.2


@dataclasses.dataclass(frozen=True)
class SensorConfig:
    """Imperfections of the colour and the depth image; 0 switches each off."""

    vignetting: float = 0.25
    """Loss of light in the image's corners, 0 to 1."""
    read_noise: float = 0.002
    """Standard deviation in the dark, share of full scale."""
    shot_noise: float = 0.008
    """Standard deviation at full scale, growing with the root of the light."""
    depth_noise: float = 0.0035
    """Standard deviation at 1 m, growing with the square of the distance, m."""
    depth_holes: float = 0.03
    """Share of pixels without depth."""
    max_depth_m: float = 9.0
    """Farther surfaces have no depth, m."""
    shutter_s: float = 0.0
    """How long the shutter is open, s: what moves meanwhile is blurred."""
    readout_s: float = 0.0
    """Rolling shutter: from the first row's exposure to the last one's, s. A frame's time and pose are those of its
    middle row; depth is seen row by row too."""


def check(config: SensorConfig) -> None:
    """Raises ValueError that names the key which no sensor can have."""
    for field in dataclasses.fields(config):
        if not getattr(config, field.name) >= 0:
            raise ValueError(f"sensor.{field.name} is {getattr(config, field.name)}: needs a value of 0 or more")


def colour_image(
    radiance: Float[Array, "H W 3"],
    exposure: Float[Array, ""],
    camera: Camera,
    config: SensorConfig,
    *,
    key: Key[Array, ""],
) -> UInt8[Array, "H W 3"]:
    """round(255 clip(E V(r) L + noise)^(1 / 2.2)), noise^2 = read^2 + shot^2 * light, V = 1 - vignetting r^2.

    Args:
      radiance: linear, 1 is full scale at exposure 1.
      exposure: gain.
      camera: for its principal point.
      config: strength of each imperfection.
      key: of the noise.
    """
    height, width, _ = radiance.shape
    x = jnp.arange(width, dtype=radiance.dtype)[None, :] - camera.intrinsics[0, 2]
    y = jnp.arange(height, dtype=radiance.dtype)[:, None] - camera.intrinsics[1, 2]
    falloff = 1 - config.vignetting * (x**2 + y**2) / ((width / 2) ** 2 + (height / 2) ** 2)
    light = jnp.clip(exposure * falloff[..., None] * radiance, 0, None)
    sd = jnp.sqrt(config.read_noise**2 + config.shot_noise**2 * light)
    light = light + sd * jax.random.normal(key, radiance.shape, radiance.dtype)
    return jnp.round(255 * jnp.clip(light, 0, 1) ** (1 / GAMMA)).astype(jnp.uint8)


def depth_image(depth_m: Float[Array, "H W"], config: SensorConfig, *, key: Key[Array, ""]) -> UInt16[Array, "H W"]:
    """Millimetres with noise of sd depth_noise Z^2 (a D435: 3.5 mm at 1 m); 0 in holes and beyond the range."""
    height, width = depth_m.shape
    noise_key, hole_key = jax.random.split(key)
    noise = config.depth_noise * depth_m**2 * jax.random.normal(noise_key, depth_m.shape, depth_m.dtype)
    coarse = jax.random.normal(hole_key, (height // 16 + 2, width // 16 + 2), depth_m.dtype)
    field = jax.image.resize(coarse, (height, width), "cubic")
    # A grid of one in 64 pixels spares sorting the image.
    holes = field > jnp.quantile(field[::8, ::8], 1 - config.depth_holes)
    seen = (depth_m > 0) & (depth_m < config.max_depth_m) & ~holes
    millimetres: Int[Array, "H W"] = jnp.round(1000 * jnp.where(seen, depth_m + noise, 0.0)).astype(jnp.int32)
    return jnp.clip(millimetres, 0, 65535).astype(jnp.uint16)
