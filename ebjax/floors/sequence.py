"""A synthetic run: a robot drives out and back along a tiled corridor with a camera and drifting wheels.

`record` makes everything but the images at once; the images come one by one, from any thread, each a pure function of
the seed and its index. Nothing is written here.
"""

import dataclasses
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key, UInt8, UInt16

from ebjax.floors import robot, sensor, tiles
from ebjax.floors.corridor import Corridor, straight_corridor
from ebjax.floors.render import Light, render
from ebjax.floors.robot import RobotConfig
from ebjax.floors.sensor import SensorConfig
from ebjax.floors.tiles import TileConfig
from ebjax.geometry.camera import Camera, camera_over_floor

Frame = tuple[UInt8[np.ndarray, "H W 3"], UInt16[np.ndarray, "H W"]]


@dataclasses.dataclass(frozen=True)
class CameraConfig:
    """A forward camera on the robot (the defaults: a RealSense D435 on a P3DX)."""

    focal_px: float = 615.0
    """Focal length, px."""
    width: int = 640
    """Image width, px; the optical axis pierces the middle."""
    height: int = 480
    """Image height, px."""
    height_m: float = 0.54
    """Above the floor, m."""
    x_m: float = 0.27
    """Ahead of the wheels' axis, m."""
    pitch_deg: float = 19.0
    """Downward tilt, degrees."""


@dataclasses.dataclass(frozen=True)
class CorridorConfig:
    """A straight corridor of tiles, driven out and back under two lights."""

    seed: int = 0
    """Everything random follows from it."""
    width_m: float = 2.4
    """Between the walls, m."""
    margin_m: float = 2.0
    """From either end of the path to the end wall, m."""
    door_spacing_m: float = 2.4
    """Between identical doors, m."""
    light_change: float = 0.35
    """How much darker the way back is, 0 to 1; its colour, its daylight and its exposure differ in proportion."""
    gloss: float = 0.15
    """Mirror image of the lamps in the floor, 0 to 1."""
    floor: TileConfig = dataclasses.field(default_factory=TileConfig)
    robot: RobotConfig = dataclasses.field(default_factory=RobotConfig)
    camera: CameraConfig = dataclasses.field(default_factory=CameraConfig)
    sensor: SensorConfig = dataclasses.field(default_factory=SensorConfig)


def check(config: CorridorConfig) -> None:
    """Raises ValueError that names the key which no corridor can have, and what it needs."""
    tiles.check(config.floor)
    robot.check(config.robot)
    for name in ("focal_px", "width", "height", "height_m"):
        if not getattr(config.camera, name) > 0:
            raise ValueError(f"camera.{name} is {getattr(config.camera, name)}: needs a value above 0")
    for name in ("width_m", "margin_m", "door_spacing_m"):
        if not getattr(config, name) > 0:
            raise ValueError(f"{name} is {getattr(config, name)}: needs a value above 0")
    for name in ("light_change", "gloss"):
        if not 0 <= getattr(config, name) <= 1:
            raise ValueError(f"{name} is {getattr(config, name)}: needs a value from 0 to 1")
    if config.margin_m <= config.camera.x_m:
        raise ValueError(
            f"margin_m is {config.margin_m}: the camera, camera.x_m = {config.camera.x_m}, would be in the wall"
        )
    needed = 2 * (abs(config.robot.lateral_offset_m) + config.robot.weave_m + 0.1)
    if config.width_m < needed:
        raise ValueError(f"width_m is {config.width_m}: the robot's path needs {needed:.2f}")


@dataclasses.dataclass(frozen=True)
class Recording:
    """A run, its images not yet made.

    Attributes:
      timestamps: s.
      world_from_base: the truth.
      odom_from_base: what the wheels counted; starts at the identity.
      camera: float32.
      frame: index -> (RGB, depth in mm with 0 = missing); safe to call from several threads.
    """

    timestamps: Float[np.ndarray, " N"]
    world_from_base: Float[np.ndarray, "N 4 4"]
    odom_from_base: Float[np.ndarray, "N 4 4"]
    camera: Camera
    frame: Callable[[int], Frame]

    def __len__(self) -> int:
        """Returns the number of frames."""
        return len(self.timestamps)


def make_corridor(config: CorridorConfig, *, key: Key[Array, ""]) -> Corridor:
    """The corridor around the path x in [0, distance]."""
    x_min, x_max = -config.margin_m, config.robot.distance_m + config.margin_m
    texture = tiles.tile_floor(x_max - x_min, config.width_m, config.floor, key=key)
    return straight_corridor(x_min, x_max, config.width_m, config.door_spacing_m, texture, config.floor.texel_m)


def make_camera(config: CameraConfig) -> Camera:
    """The camera in float32."""
    numbers = (config.focal_px, config.focal_px, config.width / 2, config.height / 2)
    camera = camera_over_floor(
        *numbers, config.width, config.height, config.height_m, float(np.radians(config.pitch_deg)), x_m=config.x_m
    )
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), camera)


def _planar(poses: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 4 4"]:
    matrices = np.tile(np.eye(4), (len(poses), 1, 1))
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 0], matrices[:, 1, 1] = c, -s, s, c
    matrices[:, :2, 3] = poses[:, :2]
    return matrices


def _lights(config: CorridorConfig) -> Light:
    """The light of the way out and of the way back, stacked."""
    change = config.light_change
    return Light(
        level=jnp.array([[1.0, 0.98, 0.94], [1 - change, (1 - 0.95 * change), (1 - 0.85 * change)]], jnp.float32),
        contrast=jnp.array([0.12, 0.12 + 0.3 * change], jnp.float32),
        slope=jnp.array([0.0, -0.06 * change], jnp.float32),
        gloss=jnp.full(2, config.gloss, jnp.float32),
    )


# Two programs: in one, XLA casts the rays again for the noise.
_see = jax.jit(render)


@partial(jax.jit, static_argnames="config")
def _expose(
    radiance: Float[Array, "H W 3"],
    depth_m: Float[Array, "H W"],
    exposure: Float[Array, ""],
    camera: Camera,
    config: SensorConfig,
    *,
    key: Key[Array, ""],
) -> tuple[UInt8[Array, "H W 3"], UInt16[Array, "H W"]]:
    colour_key, depth_key = jax.random.split(key)
    image = sensor.colour_image(radiance, exposure, camera, config, key=colour_key)
    return image, sensor.depth_image(depth_m, config, key=depth_key)


def record(config: CorridorConfig) -> Recording:
    """Lays the floor, drives the path and compiles the camera: a few seconds.

    Raises:
      ValueError: a value that no corridor, robot or camera can have; names the key.
    """
    check(config)
    floor_key, image_key = jax.random.split(jax.random.key(config.seed))
    rng = np.random.default_rng(config.seed)
    poses = robot.out_and_back(config.robot, rng)
    odometry = robot.wheel_odometry(poses, config.robot, rng)
    exposure = np.exp(rng.normal(0.0, 0.03, len(poses))).astype(np.float32)
    world_from_base = _planar(poses)
    camera, lights, corridor = make_camera(config.camera), _lights(config), make_corridor(config, key=floor_key)
    returning = (np.cos(poses[:, 2]) < 0).astype(np.int32)

    def frame(i: int) -> Frame:
        light = jax.tree.map(lambda leaf: leaf[returning[i]], lights)
        radiance, depth_m = _see(corridor, camera, jnp.asarray(world_from_base[i], jnp.float32), light)
        key = jax.random.fold_in(image_key, i)
        image, depth = _expose(radiance, depth_m, jnp.asarray(exposure[i]), camera, config.sensor, key=key)
        return np.asarray(image), np.asarray(depth)

    # Compiled here, once, so that threads need not race to do it.
    frame(0)
    timestamps = 1000.0 + config.robot.frame_s * np.arange(len(poses))
    return Recording(timestamps, world_from_base, _planar(odometry), camera, frame)
