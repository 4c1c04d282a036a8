"""A differential-drive robot that drives a route there and back, several times if asked; and what its wheels count.

Poses are (x, y, heading) in metres and radians. NumPy: a few hundred poses, made once.
"""

import dataclasses
import itertools
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from ebjax.floors.plan import polyline


class Wheels(NamedTuple):
    """An odometry's errors: fixed ones, ones drawn once a run within +- a range, and noise that adds up."""

    translation_scale: float = 1.0
    rotation_scale: float = 1.0
    heading_bias_deg_per_m: float = 0.0
    translation_range: float = 0.0
    """Of forward and of sideways error, m/m."""
    rotation_range: float = 0.0
    """rad/rad."""
    translation_noise: float = 0.0
    """Standard deviation over one metre, m; grows with the root of the distance."""
    rotation_noise_deg: float = 0.0
    """Standard deviation over one metre, degrees; grows with the root of the distance."""


WHEELS = {
    "drifting": Wheels(1.01, 1.03, 0.6, translation_noise=0.01, rotation_noise_deg=0.3),
    "d5": Wheels(1.005, 1.01, 25 / 82, translation_noise=0.01, rotation_noise_deg=0.25),
    "mobilesim": Wheels(translation_range=0.0075, rotation_range=0.0075),
    "stage": Wheels(translation_range=0.03, rotation_range=0.05),
}
MOST_NOD_DEG = 15.0
WheelsName = Literal["drifting", "d5", "mobilesim", "stage"]


@dataclasses.dataclass(frozen=True)
class RobotConfig:
    """The way and how far the wheels are to be trusted."""

    distance_m: float = 10.0
    """Length of the straight way out along x where no route is given, m."""
    route: str = ""
    """Polyline of the way out, "x y, x y, ...", m; the robot turns on the spot where it leads back."""
    passes: int = 2
    """How often the route is driven: there, back, there, ..."""
    step_m: float = 0.25
    """Distance between two frames, m."""
    turn_step_deg: float = 18.0
    """Rotation between two frames of a turn on the spot, degrees."""
    frame_s: float = 0.5
    """Time between two frames, s."""
    lateral_offset_m: float = 0.25
    """The ways back run this far to the left of the route, as they see it, m."""
    lateral_spread_m: float = 0.0
    """Every pass, out or back, runs up to this far to either side of where it would, drawn anew, m."""
    bend_m: float = 2.0
    """Length of the curve in which a bend of the route is driven, m."""
    weave_m: float = 0.03
    """Amplitude of the weaving, m."""
    weave_length_m: float = 4.0
    """Length of one weave, m."""
    stops: int = 0
    """How often the robot stands still for three frames."""
    reverse: bool = False
    """Drive the ways back backwards: the robot does not turn round, and its camera looks as on the way out."""
    wheels: WheelsName = "drifting"
    """Odometry: drifting (a bad P3DX: 0.6 deg/m), d5 (25 degrees over 82 m, as the authors' run D5), mobilesim (within
    0.0075 m/m and rad/rad, its model of the Pioneers), stage (within 0.03 m/m and 0.05 rad/rad, Stage's defaults)."""
    drift: float = 1.0
    """Factor of all those errors; 0 counts the truth."""
    nod_deg: float = 0.0
    """The body pitches and rolls by sines of 0.37 and 0.73 Hz, rms nod_deg / sqrt(2), at most 1.4 nod_deg, degrees; the
    ground truth stays that of the wheels."""
    odometry_tilt: bool = False
    """Odometry has the body's true pitch and roll, as with the help of an IMU."""


def check(config: RobotConfig) -> None:
    """Raises ValueError that names the key which no robot can have."""
    for name in ("distance_m", "passes", "step_m", "turn_step_deg", "frame_s", "weave_length_m", "bend_m"):
        if not getattr(config, name) > 0:
            raise ValueError(f"robot.{name} is {getattr(config, name)}: needs a value above 0")
    for name in ("lateral_spread_m", "weave_m", "stops", "drift"):
        if not getattr(config, name) >= 0:
            raise ValueError(f"robot.{name} is {getattr(config, name)}: needs a value of 0 or more")
    if not 0 <= config.nod_deg <= MOST_NOD_DEG:
        raise ValueError(f"robot.nod_deg is {config.nod_deg}: needs a value from 0 to {MOST_NOD_DEG:g}")
    route(config)


def route(config: RobotConfig) -> Float[np.ndarray, "K 2"]:
    """The corners of the way out.

    Raises:
      ValueError: names the key.
    """
    if config.route:
        return polyline(config.route, "robot.route")
    return np.array([[0.0, 0.0], [config.distance_m, 0.0]])


def _legs(corners: Float[np.ndarray, "K 2"]) -> list[Float[np.ndarray, "_ 2"]]:
    """Cuts a route where it turns by more than 120 degrees."""
    side = np.diff(corners, axis=0)
    side = side / np.linalg.norm(side, axis=1, keepdims=True)
    sharp = np.flatnonzero(np.sum(side[1:] * side[:-1], axis=1) < -0.5) + 1
    bounds = [0, *sharp, len(corners) - 1]
    return [corners[a : b + 1] for a, b in itertools.pairwise(bounds)]


def _centreline(corners: Float[np.ndarray, "k 2"], bend_m: float) -> Float[np.ndarray, "n 2"]:
    """Points a centimetre apart along a polyline whose corners are smoothed over `bend_m`, ends unmoved."""
    knots = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    count = max(2, round(knots[-1] / 0.01) + 1)
    s = np.linspace(0, knots[-1], count)
    points = np.stack([np.interp(s, knots, corners[:, k]) for k in (0, 1)], axis=1)
    half = min(round(bend_m / 0.01), count - 1) // 2
    if len(corners) == 2 or half < 1:
        return points
    # Reflected through the ends, a straight line stays straight.
    before, after = 2 * points[0] - points[half:0:-1], 2 * points[-1] - points[-2 : -half - 2 : -1]
    padded = np.concatenate([before, points, after])
    window = np.hanning(2 * half + 3)[1:-1]
    return np.stack([np.convolve(padded[:, k], window / window.sum(), "valid") for k in (0, 1)], axis=1)


def _drive(
    line: Float[np.ndarray, "n 2"], offset_m: float, phase: float, config: RobotConfig
) -> Float[np.ndarray, "N 3"]:
    """Poses along a smooth line, offset to its left and weaving in between; on the line at both ends.

    The offset is reached by steering: the wheels never slip sideways.
    """
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    length = along[-1]
    settle = min(3.0, length / 2)
    # The run's own ends are met in the middle of the line too, so that legs join.
    ease = np.clip(np.minimum(along, length - along) / settle, 0, 1)
    ease = ease**3 * (ease * (6 * ease - 15) + 10)
    offset = ease * (offset_m + config.weave_m * np.sin(2 * np.pi * along / config.weave_length_m + phase))
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    path = line + offset[:, None] * np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    heading = np.unwrap(np.arctan2(*np.gradient(path, axis=0).T[::-1]))
    moved = np.linalg.norm(np.diff(path, axis=0), axis=1) / config.step_m
    turned = np.degrees(np.abs(np.diff(heading))) / config.turn_step_deg
    frames = np.concatenate([[0.0], np.cumsum(np.maximum(moved, turned))])
    at = np.linspace(0, frames[-1], max(2, round(frames[-1]) + 1))
    return np.stack([np.interp(at, frames, column) for column in (path[:, 0], path[:, 1], heading)], axis=1)


def drive(config: RobotConfig, rng: np.random.Generator) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, " N"]]:
    """True poses of all passes, and the pass to which each belongs.

    Passes with an odd number go back along the route, `lateral_offset_m` to the left of it as they go, and all within
    `lateral_spread_m` of that. Turns on the spot are to the left too. With `reverse` those passes go the same way,
    their headings turned by pi.
    """
    poses, number = np.zeros((0, 3)), []
    for p in range(config.passes):
        corners = route(config)[:: -1 if p % 2 else 1]
        offset = config.lateral_offset_m if p % 2 else 0.0
        if config.lateral_spread_m:
            offset += rng.uniform(-config.lateral_spread_m, config.lateral_spread_m)
        for leg in _legs(corners):
            driven = _drive(_centreline(leg, config.bend_m), offset, rng.uniform(0, 2 * np.pi), config)
            if config.reverse and p % 2:
                driven[:, 2] += np.pi
            if len(poses):
                angle = (driven[0, 2] - poses[-1, 2]) % (2 * np.pi)
                angle = angle - 2 * np.pi if angle > 1.5 * np.pi else angle
                turns = max(1, round(abs(np.degrees(angle)) / config.turn_step_deg))
                spin = np.repeat(poses[-1:], turns - 1, axis=0)
                spin[:, 2] += angle * np.arange(1, turns) / turns
                driven[:, 2] += poses[-1, 2] + angle - driven[0, 2]
                driven = np.concatenate([spin, driven if turns > 1 or abs(angle) > 0.1 else driven[1:]])
            poses = np.concatenate([poses, driven])
            number += [p] * len(driven)
    stands = np.sort(rng.choice(len(poses), min(config.stops, len(poses)), replace=False))
    order = np.sort(np.concatenate([np.arange(len(poses)), np.repeat(stands, 3)]))
    return poses[order], np.array(number, np.float64)[order]


def step_signs(poses: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, " n"]:
    """Signs of the steps between poses: -1 where the robot drives backwards."""
    step, middle = np.diff(poses, axis=0), (poses[1:, 2] + poses[:-1, 2]) / 2
    return np.where(np.cos(middle) * step[:, 0] + np.sin(middle) * step[:, 1] < 0, -1.0, 1.0)


def wheel_odometry(
    poses: Float[np.ndarray, "N 3"],
    config: RobotConfig,
    rng: np.random.Generator,
    heights: Float[np.ndarray, " N"] | None = None,
) -> Float[np.ndarray, "N 3"]:
    """What the wheels count: each step's distance and turn, scaled, biased and noisy, summed up from (0, 0, 0).

    A step is (chord, turn), driven as an arc; its noise variance is proportional to its distance and its turn. Driven
    backwards, its distance is negative, and the errors that go with it change sign too. Standing counts nothing.
    "mobilesim" draws one error per run within +-0.0075 m/m and rad/rad (`odom_error` of the Pioneers in MobileSim's
    PioneerRobotModels.world.inc, mode random_init); "stage" within +-0.03 m/m and +-0.05 rad/rad (`odom_error
    [0.03 0.03 0.00 0.05]`, the default of Stage's position model). "d5" has the mean drift of the run D5 that the
    authors of Early Bird published: 25 degrees over 82 m.

    Args:
      poses: the truth, (x, y, heading); headings must not jump by 2 pi.
      config: which wheels, and the factor of their errors.
      rng: of the errors.
      heights: of the floor, m: wheels count what they roll up and down a ramp; None: all level.
    """
    wheels, drift = WHEELS[config.wheels], config.drift
    forward, sideways, turning = rng.uniform(-1, 1, 3)
    scale = 1 + drift * (wheels.translation_scale - 1 + wheels.translation_range * forward)
    slip = drift * wheels.translation_range * sideways
    turn_scale = 1 + drift * (wheels.rotation_scale - 1 + wheels.rotation_range * turning)
    step = np.diff(poses, axis=0)
    turn = (step[:, 2] + np.pi) % (2 * np.pi) - np.pi
    rolled = np.hypot(step[:, 0], step[:, 1])
    if heights is not None:
        rolled = np.hypot(rolled, np.diff(heights))
    distance = step_signs(poses) * rolled
    noise = drift * wheels.translation_noise * rng.normal(size=len(step))
    counted = distance * scale + np.sqrt(rolled) * noise
    # Half a metre of driving per radian is what a wheel rolls in a turn on the spot.
    rolled = rolled + 0.5 * np.abs(turn)
    counted_turn = turn * turn_scale + drift * np.radians(wheels.heading_bias_deg_per_m) * distance
    counted_turn += drift * np.radians(wheels.rotation_noise_deg) * np.sqrt(rolled) * rng.normal(size=len(step))
    heading = np.concatenate([[0.0], np.cumsum(counted_turn)])
    middle = heading[:-1] + counted_turn / 2
    x = counted * np.cos(middle) - slip * distance * np.sin(middle)
    y = counted * np.sin(middle) + slip * distance * np.cos(middle)
    return np.stack([np.concatenate([[0.0], np.cumsum(column)]) for column in (x, y)] + [heading], axis=1)
