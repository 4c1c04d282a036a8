"""A synthetic run: a robot drives the corridors of a plan with a camera and drifting wheels.

`record` makes everything but the images at once; the images come one by one, from any thread, each a pure function of
the seed and its index. Nothing is written here.
"""

import dataclasses
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key, UInt8, UInt16

from ebjax.floors import cameras, passers, robot, sensor, surface
from ebjax.floors.ageing import floors_of
from ebjax.floors.cameras import CalibrationValues, CameraConfig, make_camera
from ebjax.floors.furniture import furnish
from ebjax.floors.nod import make_nod, nodded, with_tilt_of
from ebjax.floors.passers import PassersConfig
from ebjax.floors.plan import Plan, PlanConfig, make_plan, polyline
from ebjax.floors.ramp import make_ramp, stand
from ebjax.floors.rays import Rays, bent_rays
from ebjax.floors.render import Light, Mirror, Passers, render
from ebjax.floors.robot import RobotConfig
from ebjax.floors.scene import CEILING_M, Scene, make_scene
from ebjax.floors.sensor import SensorConfig
from ebjax.floors.surface import FloorConfig
from ebjax.geometry.camera import Camera

Frame = tuple[UInt8[np.ndarray, "H W 3"], UInt16[np.ndarray, "H W"]]
SHUTTER_TAPS = 3
WINDOWS = 32


@dataclasses.dataclass(frozen=True)
class CorridorConfig:
    """Corridors with one kind of floor, driven there and back under changing light."""

    seed: int = 0
    """Everything random follows from it."""
    light_change: float = 0.35
    """How much the light of later passes differs from the first's, 0 to 1: level, colour, daylight, exposure."""
    exposure_change: float = 0.0
    """How much the exposure differs from pass to pass: standard deviation of its natural logarithm."""
    gloss: float | None = None
    """Mirror image of the lamps in the floor, 0 to 1; None: that of the floor's family."""
    mirror: float = 0.0
    """Mirror image of walls, doors and ceiling in the floor, 0 to 1; 0: of the room only the lamps are mirrored."""
    windows: float = 0.0
    """Radiance of windows in the walls, one between two doors, a white floor's being 1; needs `mirror`."""
    rough: float = 0.03
    """Softness of that mirror image: a metre from the floor it is blurred over so many metres."""
    lamp_m: tuple[float, float, float] | None = None
    """Spacing, length and width of the lamps, m; None: square panels."""
    sun: float = 0.0
    """Sunlight through some windows onto the floor, times the lamps' light; it wanders and fades between passes."""
    landmarks_per_m: float = 0.0
    """Furniture and pictures a metre of wall, and walls of different colours; 0 leaves corridors bare."""
    floor: FloorConfig = dataclasses.field(default_factory=FloorConfig)
    plan: PlanConfig = dataclasses.field(default_factory=PlanConfig)
    robot: RobotConfig = dataclasses.field(default_factory=RobotConfig)
    camera: CameraConfig = dataclasses.field(default_factory=CameraConfig)
    passers: PassersConfig = dataclasses.field(default_factory=PassersConfig)
    sensor: SensorConfig = dataclasses.field(default_factory=SensorConfig)


def check(config: CorridorConfig, calibration: CalibrationValues | None = None) -> None:
    """Raises ValueError that names the key which no world can have, and what it needs.

    Args:
      config: the world, the robot and its camera.
      calibration: what is in `camera.file`; None where that is not read yet.
    """
    surface.check(config.floor)
    robot.check(config.robot)
    cameras.check(config.camera, calibration)
    passers.check(config.passers)
    sensor.check(config.sensor)
    for name in ("width_m", "margin_m", "door_spacing_m"):
        if not getattr(config.plan, name) > 0:
            raise ValueError(f"plan.{name} is {getattr(config.plan, name)}: needs a value above 0")
    for name in ("light_change", "gloss", "mirror"):
        value = getattr(config, name)
        if value is not None and not 0 <= value <= 1:
            raise ValueError(f"{name} is {value}: needs a value from 0 to 1")
    if config.windows and not config.mirror:
        raise ValueError(f"windows is {config.windows}, mirror is 0: needs a floor that mirrors them")
    if config.lamp_m is not None and not min(config.lamp_m) > 0:
        raise ValueError(f"lamp_m is {config.lamp_m}: needs a spacing, a length and a width above 0")
    for name in ("sun", "landmarks_per_m", "exposure_change", "windows", "rough"):
        if not getattr(config, name) >= 0:
            raise ValueError(f"{name} is {getattr(config, name)}: needs a value of 0 or more")
    x_m = cameras.position(config.camera, calibration)[0]
    if config.plan.margin_m <= x_m:
        raise ValueError(f"plan.margin_m is {config.plan.margin_m}: the camera, {x_m} m ahead, would be in the wall")
    needed = 2 * (abs(config.robot.lateral_offset_m) + config.robot.lateral_spread_m + config.robot.weave_m + 0.1)
    if config.plan.width_m < needed:
        raise ValueError(f"plan.width_m is {config.plan.width_m}: the robot's path needs {needed:.2f}")
    if config.sensor.readout_s > config.robot.frame_s:
        raise ValueError(f"sensor.readout_s is {config.sensor.readout_s}: needs at most robot.frame_s")
    make_ramp(config.plan)


def plan_of(config: CorridorConfig) -> Plan:
    """The plan; by default one corridor along the robot's route.

    Raises:
      ValueError: a polyline that is none; names the key.
    """
    lines = [polyline(text, f"plan.corridors[{i}]") for i, text in enumerate(config.plan.corridors)]
    return make_plan(lines or [robot.route(config.robot)], config.plan.width_m, config.plan.margin_m)


@dataclasses.dataclass(frozen=True)
class Recording:
    """A run, its images not yet made.

    Attributes:
      timestamps: s.
      world_from_base: the truth; tilted and raised on a ramp.
      world_from_body: the truth of the body that carries the camera; other than the base's if it nods.
      odom_from_base: what the wheels counted; starts at the identity, but for tilt.
      camera: float32.
      frame: index -> (RGB, depth in mm with 0 = missing); safe to call from several threads.
      scene: the world that is seen, on the first pass.
    """

    timestamps: Float[np.ndarray, " N"]
    world_from_base: Float[np.ndarray, "N 4 4"]
    world_from_body: Float[np.ndarray, "N 4 4"]
    odom_from_base: Float[np.ndarray, "N 4 4"]
    camera: Camera
    frame: Callable[[int], Frame]
    scene: Scene

    def __len__(self) -> int:
        """Returns the number of frames."""
        return len(self.timestamps)


def lights(config: CorridorConfig, rng: np.random.Generator) -> list[Light]:
    """The light of every pass: the first as it should be, the others darker, tinted, from another side."""
    passes, change = config.robot.passes, config.light_change
    by = np.where(np.arange(passes) > 0, rng.uniform(0.7, 1.0, passes), 0.0) * change
    gloss = surface.family(config.floor.family).gloss if config.gloss is None else config.gloss
    windows = np.where(rng.uniform(size=WINDOWS) < 0.3, rng.uniform(0.4, 1.0, WINDOWS), 0.0)
    sun = config.sun * np.where(np.arange(passes) > 0, rng.uniform(0.2, 1.0, passes), 1.0)[:, None] * windows
    columns = [
        np.array([1.0, 0.98, 0.94]) * (1 - by[:, None] * np.array([1.0, 0.95, 0.85])),
        0.12 + 0.3 * by,
        0.06 * by[:, None] * rng.uniform(-1, 1, (passes, 2)),
        np.full(passes, gloss),
        sun,
        np.cumsum(np.append(0.0, rng.uniform(0.4, 2.4, passes - 1))),
    ]
    same = [jnp.asarray(np.float32(value)) for value in (config.mirror, config.windows, config.rough)]
    mirror = Mirror(*same) if config.mirror else None

    def of_pass(k: int) -> Light:
        level, contrast, slope, shine, sunny, shift = (jnp.asarray(np.float32(column[k])) for column in columns)
        return Light(level, contrast, slope, shine, sunny, shift, mirror)

    return [of_pass(k) for k in range(passes)]


# Two programs: in one, XLA casts the rays again for the noise.
_see = jax.jit(render)


@jax.jit
def _see_blurred(
    scene: Scene,
    camera: Camera,
    world_from_base: Float[Array, "K *H 4 4"],
    light: Light,
    passing: Passers,
    rays: Rays | None,
) -> tuple[Float[Array, "H W 3"], Float[Array, "H W"]]:
    """Mean radiance over the poses of an open shutter; the depth is that of the middle one."""
    radiance, depth_m = jax.lax.map(lambda pose: render(scene, camera, pose, light, passing, rays), world_from_base)
    return radiance.mean(axis=0), depth_m[len(world_from_base) // 2]


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


def _compile_exposing(camera: Camera, config: SensorConfig) -> None:
    radiance = np.zeros((camera.height, camera.width, 3), np.float32)
    _expose(radiance, radiance[..., 0], np.float32(1), camera, config, key=jax.random.key(0))


def moment_times(height: int, config: CorridorConfig) -> Float[np.ndarray, "*s"]:
    """When a frame is seen: one a moment of an open shutter, one a row of a rolling one; s from its middle."""
    times = np.zeros(())
    if config.sensor.shutter_s > 0:
        times = config.sensor.shutter_s * np.linspace(-0.5, 0.5, SHUTTER_TAPS)
    if config.sensor.readout_s > 0:
        times = times[..., None] + config.sensor.readout_s * np.linspace(-0.5, 0.5, height)
    return times


def moments(poses: Float[np.ndarray, "N 3"], i: int, height: int, config: CorridorConfig) -> Float[np.ndarray, "*s 3"]:
    """Poses from which frame i is seen, at its `moment_times`.

    They lie on the straight line of the velocity between the frames before and after.
    """
    times = moment_times(height, config) / config.robot.frame_s
    velocity = (poses[min(i + 1, len(poses) - 1)] - poses[max(i - 1, 0)]) / 2
    return poses[i] + times[..., None] * velocity


def check_inside(
    config: CorridorConfig,
    plan: Plan,
    poses: Float[np.ndarray, "N 3"],
    calibration: CalibrationValues | None = None,
) -> None:
    """Raises ValueError where robot or camera would be outside the corridors, or the camera in the floor."""
    at = cameras.position(config.camera, calibration)
    level = (stand(poses, None) @ np.append(at, 1.0))[:, :2]
    # Within the robot's half width of a wall at its wheels; the camera may come closer in a turn.
    kept = plan.inside(poses[:, :2], 0.2).any(axis=0) & plan.inside(level, 0.05).any(axis=0)
    if not kept.all():
        x, y = poses[np.argmin(kept), :2]
        raise ValueError(
            f"robot.route is {config.robot.route!r}: leaves the corridors at ({x:.1f}, {y:.1f}); "
            "correct it, plan.corridors or robot.lateral_offset_m"
        )
    ramp, nod = make_ramp(config.plan), make_nod(config.robot.nod_deg, config.seed)
    if ramp is None and nod is None:
        return
    body = nodded(stand(poses, ramp), nod, config.robot.frame_s * np.arange(len(poses)))
    x, y, z, _ = np.moveaxis(body @ np.append(at, 1.0), -1, 0)
    what = f"plan.ramp_deg is {config.plan.ramp_deg}" if nod is None else f"robot.nod_deg is {config.robot.nod_deg}"
    above = z if ramp is None else z - ramp.height(x, y)
    if not (above.min() > 0.01 and above.max() < CEILING_M - 0.01):
        raise ValueError(
            f"{what}: the camera is {above.min():.2f} to {above.max():.2f} m above the floor, needs 0.01 to "
            f"{CEILING_M - 0.01:.2f}; correct it or camera.height_m"
        )
    if nod is not None and not plan.inside(np.stack([x, y], axis=1), 0.05).any(axis=0).all():
        raise ValueError(f"{what}: the camera nods into a wall; lower it, or widen plan.width_m")


def record(
    config: CorridorConfig,
    photographs: Float[np.ndarray, "N n n 3"] | None = None,
    calibration: CalibrationValues | None = None,
) -> Recording:
    """Lays the floor, drives the route and compiles the camera: some seconds, more for long corridors.

    Args:
      config: the world, the robot and its camera.
      photographs: linear reflectance, what the floor family "photograph" lays.
      calibration: what is in `camera.file`.

    Raises:
      ValueError: a value that no corridor, robot or camera can have; names the key.
    """
    if config.camera.file is not None and calibration is None:
        raise ValueError(f"camera.file is {config.camera.file}: read it with read_calibration and pass what it says")
    check(config, calibration)
    floor_key, image_key = jax.random.split(jax.random.key(config.seed))
    rng = np.random.default_rng(config.seed)
    poses, passes = robot.drive(config.robot, rng)
    plan = plan_of(config)
    check_inside(config, plan, poses, calibration)
    ramp, nod = make_ramp(config.plan), make_nod(config.robot.nod_deg, config.seed)
    heights = None if ramp is None else ramp.height(poses[:, 0], poses[:, 1])
    odometry = robot.wheel_odometry(poses, config.robot, rng, heights)
    exposure = rng.normal(0.0, 0.03, len(poses))
    if config.exposure_change:
        exposure += rng.normal(0.0, config.exposure_change, config.robot.passes)[passes.astype(int)]
    exposure = np.exp(exposure).astype(np.float32)
    times_s = config.robot.frame_s * np.arange(len(poses))
    world_from_base, odom_from_base = stand(poses, ramp), stand(odometry, None)
    world_from_body = nodded(world_from_base, nod, times_s)
    if config.robot.odometry_tilt:
        odom_from_base = with_tilt_of(odom_from_base, world_from_body)
    camera, of_pass = make_camera(config.camera, calibration), lights(config, rng)
    rays = None if camera.lens.model == "pinhole" else bent_rays(camera)
    furniture, paints = furnish(plan, config.landmarks_per_m, rng)
    exposing = ThreadPoolExecutor(1).submit(_compile_exposing, camera, config.sensor)  # beside the floor's programs
    walks = passers.plan_walks(poses, config.robot.frame_s, config.plan.width_m / 2, config.passers, rng)
    floor = floors_of(plan, config.floor, key=floor_key, photographs=photographs)
    scene = make_scene(plan, floor(0), config.plan.door_spacing_m, furniture, paints, ramp, config.lamp_m)

    def frame(i: int) -> Frame:
        passing = passers.at_frame(walks, poses, i)
        see = _see_blurred if config.sensor.shutter_s > 0 else _see
        seen_from = stand(moments(poses, i, camera.height, config), ramp)
        seen_from = nodded(seen_from, nod, np.asarray(times_s[i] + moment_times(camera.height, config)))
        seen = dataclasses.replace(scene, floor=floor(int(passes[i])))
        radiance, depth_m = see(seen, camera, np.asarray(seen_from, np.float32), of_pass[int(passes[i])], passing, rays)
        key = jax.random.fold_in(image_key, i)
        image, depth = _expose(radiance, depth_m, jnp.asarray(exposure[i]), camera, config.sensor, key=key)
        return np.asarray(image), np.asarray(depth)

    # Compiled here, once, so that threads need not race to do it.
    exposing.result()
    frame(0)
    poses_of = world_from_base, world_from_body, odom_from_base
    return Recording(1000.0 + times_s, *poses_of, camera, frame, scene)
