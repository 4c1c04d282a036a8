"""Where the ground is not flat: steps whose matches fit no planar motion until one of the two views is tilted.

At either end of a ramp the robot pitches from one frame to the next, and its camera sees the floor under another angle
than its mount says. Nearly all matches of such a step disagree; under the right pitch they agree.
"""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ebjax.features.settle import PairMatches, on_floor
from ebjax.geometry.camera import Camera
from ebjax.geometry.planar import between
from ebjax.odometry.floor_steps import FloorPairs
from ebjax.odometry.steps import MIN_INLIERS

LEAST_MATCHES = 60
MOST_AGREE = 0.2
"""Share of the matches that agree without the tilt."""
CLEARLY = 3.0
"""... and with it so many times as many."""
CLOSE = 0.9
LEAST_DEG = 1.0
PITCHES_DEG = np.arange(-12.0, 12.25, 0.5)
REACH = 2.0
"""Tolerances that a match may be off: the pitch is a multiple of half a degree, the motion another witness's."""


@dataclasses.dataclass(frozen=True)
class Bend:
    """A step, by the row of its later keyframe, over which the robot pitches by about so many degrees."""

    row: int
    degrees: float


@partial(jax.jit, static_argnames="tolerance_m")
def _agreeing(matches: PairMatches, motion: Float[Array, "3"], camera: Camera, tolerance_m: float):
    """Matches that agree with a motion where the camera of frame i, or of frame j, is tilted: 2 x pitches."""
    c, s = jnp.cos(motion[2]), jnp.sin(motion[2])
    turn = jnp.stack([jnp.stack([c, -s]), jnp.stack([s, c])])

    def under(pitch):
        s, c, zero, one = jnp.sin(pitch), jnp.cos(pitch), jnp.zeros_like(pitch), jnp.ones_like(pitch)
        nod = jnp.stack([jnp.stack([c, zero, s]), jnp.stack([zero, one, zero]), jnp.stack([-s, zero, c])])
        pose = jnp.asarray(camera.base_from_camera)
        tilted = dataclasses.replace(camera, base_from_camera=pose.at[:3].set(nod @ pose[:3]))
        return on_floor(matches.pixels_i, tilted), on_floor(matches.pixels_j, tilted)

    def count(i, j):
        off = i - (j @ turn.T + motion[None, :2])
        return jnp.sum(matches.matched & (jnp.sum(off**2, 1) < (REACH * tolerance_m) ** 2))

    level_i, level_j = under(jnp.zeros(()))
    pitches_i, pitches_j = jax.lax.map(under, jnp.radians(jnp.asarray(PITCHES_DEG)))
    return jnp.stack(
        [jax.vmap(lambda i: count(i, level_j))(pitches_i), jax.vmap(lambda j: count(level_i, j))(pitches_j)]
    )


def bends(pairs: FloorPairs, poses: Float[np.ndarray, "N 3"], camera: Camera, tolerance_m: float) -> list[Bend]:
    """Steps between successive keyframes over which the ground bends.

    Args:
      pairs: of keyframes.
      poses: where the keyframes are, by whatever else measured these steps.
      camera: as it is mounted.
      tolerance_m: largest distance of matching points on the floor.
    """
    disagree = (pairs.total >= LEAST_MATCHES) & (pairs.inliers < MOST_AGREE * pairs.total) & (pairs.i - pairs.j == 1)
    found = []
    for k in np.flatnonzero(disagree):
        one = jax.tree.map(lambda leaf: leaf[0], pairs.matches(np.array([k])))
        motion = between(poses[pairs.i[k]], poses[pairs.j[k]])
        agree = np.asarray(_agreeing(one, motion, camera, tolerance_m))
        best = agree.max()
        near = np.abs(PITCHES_DEG)[None] + np.where(agree >= CLOSE * best, 0, np.inf)
        pitch = np.unravel_index(near.argmin(), near.shape)[1]
        level = agree[:, np.abs(PITCHES_DEG) <= LEAST_DEG].max()
        if best >= MIN_INLIERS and best >= CLEARLY * level:
            found.append(Bend(int(pairs.i[k]), float(abs(PITCHES_DEG[pitch]))))
    return found


def ground_warnings(
    bent: list[Bend], times: Float[np.ndarray, " N"], poses: Float[np.ndarray, "N 3"]
) -> tuple[str, ...]:
    """What the user should know of it, a line."""
    if not bent:
        return ()
    places = ", ".join(
        f"{b.degrees:.0f} degrees at {times[b.row]:.3f} s (x {poses[b.row, 0]:.1f}, y {poses[b.row, 1]:.1f} m)"
        for b in bent[:4]
    )
    more = f" and at {len(bent) - 4} more steps" if len(bent) > 4 else ""
    return (
        f"the ground is not flat: the robot pitches by about {places}{more}. Around a ramp or a threshold the floor "
        "measures little, and closures there are few",
    )
