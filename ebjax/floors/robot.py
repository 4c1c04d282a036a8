"""A differential-drive robot that drives out along x, turns on the spot, and comes back beside its own tracks.

Poses are (x, y, heading) in metres and radians. NumPy: a few hundred poses, made once.
"""

import dataclasses

import numpy as np
from jaxtyping import Float


@dataclasses.dataclass(frozen=True)
class RobotConfig:
    """The path and how far the wheels are to be trusted (the defaults drift like a P3DX on a bad day)."""

    distance_m: float = 10.0
    """Length of the way out, m."""
    step_m: float = 0.25
    """Distance between two frames, m."""
    turn_step_deg: float = 18.0
    """Rotation between two frames of the U-turn, degrees."""
    frame_s: float = 0.5
    """Time between two frames, s."""
    lateral_offset_m: float = 0.25
    """The way back runs this far to the left of the way out, seen along x negative, m."""
    weave_m: float = 0.03
    """Amplitude of the weaving, m."""
    weave_length_m: float = 4.0
    """Length of one weave, m."""
    translation_scale: float = 1.01
    """Metres that the wheels count per metre driven."""
    rotation_scale: float = 1.03
    """Radians that the wheels count per radian turned."""
    heading_bias_deg_per_m: float = 0.6
    """Systematic drift of the heading, degrees per metre: one wheel a little smaller than the other."""
    translation_noise: float = 0.01
    """Standard deviation of one metre's distance, m (grows with the root of the distance)."""
    rotation_noise_deg: float = 0.3
    """Standard deviation of the heading over one metre, degrees (grows with the root of the distance)."""


def check(config: RobotConfig) -> None:
    """Raises ValueError that names the key which no robot can have."""
    for name in (
        "distance_m",
        "step_m",
        "turn_step_deg",
        "frame_s",
        "weave_length_m",
        "translation_scale",
        "rotation_scale",
    ):
        if not getattr(config, name) > 0:
            raise ValueError(f"robot.{name} is {getattr(config, name)}: needs a value above 0")
    for name in ("weave_m", "translation_noise", "rotation_noise_deg"):
        if not getattr(config, name) >= 0:
            raise ValueError(f"robot.{name} is {getattr(config, name)}: needs a value of 0 or more")


def out_and_back(config: RobotConfig, rng: np.random.Generator) -> Float[np.ndarray, "N 3"]:
    """True poses: heading tangent to y(x), a half turn to the left at the end, then back along y(x) - offset.

    The offset is reached by steering over the first 3 m of the way back: the wheels never slip sideways.
    """
    phases = rng.uniform(0, 2 * np.pi, 2)
    wave = 2 * np.pi / config.weave_length_m

    def leg(x: np.ndarray, phase: float, offset_m: float, direction: float) -> Float[np.ndarray, "n 3"]:
        settle = min(3.0, config.distance_m)
        s = np.clip((config.distance_m - x) / settle, 0, 1) if direction < 0 else np.ones_like(x)
        ease, ease_slope = s**3 * (s * (6 * s - 15) + 10), 30 * s**2 * (1 - s) ** 2 * (-1 / settle)
        # Weaving fades out at the turn so that both ways meet it in the same place.
        fade = np.clip((config.distance_m - x) / settle, 0, 1)
        fade_slope = np.where(fade < 1, -1 / settle, 0.0)
        weave, weave_slope = np.sin(wave * x + phase), wave * np.cos(wave * x + phase)
        y = config.weave_m * fade**2 * weave + offset_m * ease
        slope = config.weave_m * (2 * fade * fade_slope * weave + fade**2 * weave_slope)
        slope = slope + (offset_m * ease_slope if direction < 0 else 0.0)
        return np.stack([x, y, np.arctan2(direction * slope, np.full_like(x, direction))], axis=1)

    count = max(2, round(config.distance_m / config.step_m) + 1)
    x = np.linspace(0.0, config.distance_m, count)
    out = leg(x, phases[0], 0.0, 1.0)
    back = leg(x[::-1], phases[1], -config.lateral_offset_m, -1.0)
    turns = max(2, round(180 / config.turn_step_deg))
    turn = np.repeat(out[-1:], turns - 1, axis=0)
    turn[:, 2] += np.pi * np.arange(1, turns) / turns
    poses = np.concatenate([out, turn, back])
    poses[:, 2] = np.unwrap(poses[:, 2])
    return poses


def wheel_odometry(
    poses: Float[np.ndarray, "N 3"], config: RobotConfig, rng: np.random.Generator
) -> Float[np.ndarray, "N 3"]:
    """What the wheels count: each step's distance and turn, scaled, biased and noisy, summed up from (0, 0, 0).

    A step is (chord, turn), driven as an arc; its noise variance is proportional to its distance and its turn.
    """
    step = np.diff(poses, axis=0)
    turn = (step[:, 2] + np.pi) % (2 * np.pi) - np.pi
    distance = np.hypot(step[:, 0], step[:, 1])
    counted = distance * config.translation_scale + config.translation_noise * np.sqrt(distance) * rng.normal(
        size=len(step)
    )
    # Half a metre of driving per radian is what a wheel rolls in a turn on the spot.
    rolled = distance + 0.5 * np.abs(turn)
    counted_turn = turn * config.rotation_scale + np.radians(config.heading_bias_deg_per_m) * distance
    counted_turn += np.radians(config.rotation_noise_deg) * np.sqrt(rolled) * rng.normal(size=len(step))
    heading = np.concatenate([[0.0], np.cumsum(counted_turn)])
    middle = heading[:-1] + counted_turn / 2
    x = np.concatenate([[0.0], np.cumsum(counted * np.cos(middle))])
    y = np.concatenate([[0.0], np.cumsum(counted * np.sin(middle))])
    return np.stack([x, y, heading], axis=1)
