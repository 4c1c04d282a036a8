"""People and carts that come the robot's way now and then and hide floor: where they are at each frame.

NumPy; a passer follows the robot's own route, beside it, so that it stays between the walls.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ebjax.floors.obstacles import Boxes, Posts, no_boxes, no_posts
from ebjax.floors.render import Passers
from ebjax.floors.robot import step_signs

LEG_M, STRIDE_M, CROTCH_M, SHOULDER_M = 0.065, 0.6, 0.86, 1.5
CART = (0.42, 0.25, 0.16, 0.95)
COLOURS = np.array(
    [[0.05, 0.06, 0.10], [0.10, 0.10, 0.10], [0.16, 0.12, 0.08], [0.03, 0.03, 0.035], [0.25, 0.25, 0.27]]
)


@dataclasses.dataclass(frozen=True)
class PassersConfig:
    """Who else is there."""

    share: float = 0.0
    """Expected share of frames in which somebody is ahead of the robot, 0 to 1."""
    carts: float = 0.3
    """Share of them that push a cart."""
    speed_mps: float = 1.1
    """How fast they walk, m/s."""


def check(config: PassersConfig) -> None:
    """Raises ValueError that names the key which nobody can have."""
    for name in ("share", "carts"):
        if not 0 <= getattr(config, name) <= 1:
            raise ValueError(f"passers.{name} is {getattr(config, name)}: needs a value from 0 to 1")
    if not config.speed_mps > 0:
        raise ValueError(f"passers.speed_mps is {config.speed_mps}: needs a value above 0")


@dataclasses.dataclass(frozen=True)
class Walk:
    """One passer: first and last frame, distance ahead of the robot at each, side, and what is carried."""

    first: int
    last: int
    ahead_m: Float[np.ndarray, " K"]
    side_m: float
    cart: bool
    colour: int


def plan_walks(
    poses: Float[np.ndarray, "N 3"],
    frame_s: float,
    half_width_m: float,
    config: PassersConfig,
    rng: np.random.Generator,
) -> list[Walk]:
    """Draws walks one after another until the share of frames is reached."""
    walks: list[Walk] = []
    frame = 0
    if config.share == 0:
        return walks
    step = np.append(step_signs(poses) * np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1), 0.0)
    while frame < len(poses):
        oncoming = rng.uniform() < 0.6
        speed = config.speed_mps * rng.uniform(0.8, 1.2) * (-1 if oncoming else 0.9)
        start = rng.uniform(4.0, 7.0) if oncoming else rng.uniform(0.9, 1.3)
        frames = int(rng.integers(6, 16))
        last = min(frame + frames, len(poses))
        ahead = start + np.concatenate([[0.0], np.cumsum(speed * frame_s - step[frame : last - 1])])
        side = rng.choice([-1, 1]) * rng.uniform(0.35, max(0.4, half_width_m - 0.35))
        seen = np.flatnonzero((ahead > 0.6) & (ahead < 8.0))
        if len(seen):
            count = int(seen[-1]) + 1
            walks.append(
                Walk(
                    frame, frame + count, ahead[:count], side, bool(rng.uniform() < config.carts), int(rng.integers(5))
                )
            )
            frame += count
        frame += 1 + int(rng.exponential(max(frames * (1 / config.share - 1), 1e-9)))
    return walks


def at_frame(walks: list[Walk], poses: Float[np.ndarray, "N 3"], frame: int) -> Passers:
    """Who stands where at a frame: always the same number of boxes and posts, those of nobody of size 0."""
    if not walks:
        return Passers(no_boxes(), no_posts())
    current = [walk for walk in walks if walk.first <= frame < walk.last]
    x, y, heading = poses[frame]
    ahead_axis, left_axis = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
    box, post = np.zeros((3, 14)), np.zeros((3, 8))
    box[:, 2], box[:, :2], post[:, :2] = 1.0, 1e3, 1e3
    if current:
        walk = current[0]
        ahead = walk.ahead_m[frame - walk.first]
        centre = np.array([x, y]) + ahead * ahead_axis + walk.side_m * left_axis
        colour = COLOURS[walk.colour]
        swing = 0.5 * STRIDE_M * np.sin(np.pi * (ahead + frame * 0.7) / STRIDE_M)
        for k, sign in enumerate((-1, 1)):
            foot = centre + sign * (0.5 * swing * ahead_axis + 0.09 * left_axis)
            post[k] = [*foot, LEG_M, 0.06, CROTCH_M, *colour]
            box[k] = [*(foot + 0.05 * ahead_axis), *ahead_axis, 0.14, 0.05, 0.0, 0.08, *(0.5 * colour), *(0.3 * colour)]
        post[2] = [*centre, 0.2, CROTCH_M, SHOULDER_M, *(1.6 * colour[::-1])]
        if walk.cart:
            steel = np.array([0.35, 0.36, 0.38])
            box[2] = [*(centre - 0.65 * ahead_axis), *ahead_axis, *CART, *steel, *(0.25 * steel)]
    boxes = Boxes(*(jnp.asarray(n, jnp.float32) for n in _split(box)))
    posts = Posts(
        *(jnp.asarray(n, jnp.float32) for n in (post[:, :2], post[:, 2], post[:, 3], post[:, 4], post[:, 5:]))
    )
    return Passers(boxes, posts)


def _split(box: Float[np.ndarray, "B 14"]):
    colours = box[:, 8:14].reshape(-1, 2, 3)
    return box[:, :2], box[:, 2:4], box[:, 4:6], box[:, 6], box[:, 7], colours, np.full(len(box), 0.3)
