"""The camera's mount checks itself: pitch and roll from how matched floor points fail to move rigidly.

A floor point at the distance d moves by (h^2 + d^2) / h per radian of pitch, so that a pair seen under a wrong tilt
fits no planar motion. Every pair's motion is an unknown of its own and is eliminated (Schur); residuals are whitened by
what the match spreads over the floor under the same mount: metric ones would shrink the picture. Height cannot be told
by that, as it only scales.
"""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ebjax.features.settle import FREEDOM, LEAST_FACTOR, MEDIAN, PairMatches, spread_on_floor, white
from ebjax.geometry.camera import Camera
from ebjax.geometry.mount import Mounting, remounted

PRIOR_DEG = 2.0
"""Standard deviation of pitch and roll as given, degrees."""
SHARED = 3.0
"""Pairs see the same corners again, and lens and corners err alike: standard deviations are so many times wider."""
SIGNIFICANT = 13.8
"""The 99.9 % point of chi-square with two degrees of freedom: below it the mount stays as it is."""
MOST_DEG, MOST_SIGMA_DEG = 5.0, 0.3
"""A tilt beyond is no mount's error but a floor that shows nothing; so is one that is less certain."""
FEWEST = 20
MATCHES = 64
PAIRS = 256
ROUNDS = 5


@dataclasses.dataclass(frozen=True)
class Tilt:
    """What pitch and roll were found to be off by, degrees, with deviations, and whether that was put right."""

    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    pitch_sigma_deg: float = PRIOR_DEG
    roll_sigma_deg: float = PRIOR_DEG
    pairs: int = 0
    applied: bool = False

    def further(self, more: "Tilt") -> "Tilt":
        """This where it was put right, and what was found beyond it."""
        pitch, roll = (self.pitch_deg, self.roll_deg) if self.applied else (0.0, 0.0)
        off = pitch + more.pitch_deg, roll + more.roll_deg
        return Tilt(*off, more.pitch_sigma_deg, more.roll_sigma_deg, more.pairs, self.applied or more.applied)


def tilted(camera: Camera, tilt: Float[Array, "2"]) -> Camera:
    """The camera with pitch and roll added, rad."""
    return remounted(camera, Mounting(tilt[0], tilt[1], jnp.zeros_like(tilt[0])))


@jax.jit
def _solve(matches: PairMatches, use: Float[Array, " P"], camera: Camera, tolerance_m: float | Float[Array, ""]):
    axes = jnp.eye(2)

    def whitened(tilt, motions):
        """Residuals of p_i = R p_j + t, whitened and in metres, P x M x 2."""
        here = tilted(camera, tilt)
        points_i, points_j, spread = jax.vmap(lambda pair: spread_on_floor(pair, here))(matches)
        c, s = jnp.cos(motions[:, 2, None]), jnp.sin(motions[:, 2, None])
        x, y = points_j[..., 0], points_j[..., 1]
        moved = jnp.stack([c * x - s * y, s * x + c * y], -1)
        metric = points_i - moved - motions[:, None, :2]
        return white(metric, spread), metric, moved, spread

    def round_(state, _):
        tilt, motions = state
        (plain, metric, moved, spread), along = jax.linearize(lambda t: whitened(t, motions), tilt)
        by_tilt = jax.vmap(lambda axis: along(axis)[0], out_axes=-1)(axes)
        by_x, by_y = (jnp.broadcast_to(-axis, moved.shape) for axis in axes)
        by_turn = jnp.stack([moved[..., 1], -moved[..., 0]], -1)
        by_motion = [white(column, spread) for column in (by_x, by_y, by_turn)]
        both = jnp.concatenate([by_tilt, jnp.stack(by_motion, -1)], -1)
        near = matches.matched & (jnp.sum(metric**2, -1) < tolerance_m**2)
        relative = jnp.sum(plain**2, -1)
        ranked = jnp.sort(jnp.where(near, relative, jnp.inf), axis=1)
        middle = jnp.take_along_axis(ranked, near.sum(1, keepdims=True) // 2, axis=1)
        factor = jnp.maximum(jnp.where(jnp.isfinite(middle), middle, 1.0) / MEDIAN, LEAST_FACTOR)
        weight = (FREEDOM + 2) / ((FREEDOM + relative / factor) * factor)
        weight = jnp.where(near, weight * use[:, None], 0)[..., None]
        flat = (len(use), -1)
        weighted = (both * weight[..., None]).reshape(*flat, 5)
        hessian = jnp.swapaxes(weighted, 1, 2) @ both.reshape(*flat, 5) + 1e-9 * jnp.eye(5)[None]
        gradient = jnp.sum(weighted * plain.reshape(*flat, 1), 1)
        tt, tm, mm = hessian[:, :2, :2], hessian[:, :2, 2:], hessian[:, 2:, 2:]
        back = jnp.linalg.solve(mm, jnp.concatenate([jnp.swapaxes(tm, 1, 2), gradient[:, 2:, None]], -1))
        prior = jnp.eye(2) / jnp.radians(PRIOR_DEG) ** 2
        schur = jnp.sum(tt - tm @ back[:, :, :2], 0) + prior
        pull = jnp.sum(gradient[:, :2] - (tm @ back[:, :, 2:])[..., 0], 0) + prior @ tilt
        delta = -jnp.linalg.solve(schur, pull)
        return (tilt + delta, motions - back[..., 2] - back[:, :, :2] @ delta), schur

    (tilt, _), schur = jax.lax.scan(round_, (jnp.zeros(2), matches.start), None, length=ROUNDS)
    return tilt, jnp.linalg.inv(schur[-1])


def refine_tilt(
    matches: Callable[[Int[np.ndarray, " n"]], PairMatches],
    used: Bool[np.ndarray, " P"],
    camera: Camera,
    tolerance_m: float,
    *,
    certain: bool = True,
) -> tuple[Camera, Tilt]:
    """Pitch and roll of a camera, from pairs that look at the same floor, in the same or in opposite direction.

    Args:
      matches: of some of the pairs, with starts that are right to about the tolerance.
      used: which pairs count; at most 256 of them, evenly spread, are looked at.
      camera: as it is thought to be mounted.
      tolerance_m: matches that are farther off than twice this count for nothing.
      certain: whether the mount stays as it is unless it is contradicted significantly.
    """
    rows = np.flatnonzero(used)
    if len(rows) < FEWEST:
        return camera, Tilt(pairs=len(rows))
    if len(rows) > PAIRS:
        rows = rows[np.linspace(0, len(rows) - 1, PAIRS).round().astype(int)]
    padded = np.resize(np.arange(len(rows)), PAIRS)
    some = jax.tree.map(lambda leaf: np.asarray(leaf)[padded], matches(rows))
    names = ("pixels_i", "pixels_j", "points_i", "points_j", "matched", "spread")
    some = dataclasses.replace(some, **{name: getattr(some, name)[:, :MATCHES] for name in names})
    use = np.where(np.arange(PAIRS) < len(rows), 1.0, 0.0)
    tilt, covariance = (np.asarray(x) for x in _solve(some, use, camera, 2 * tolerance_m))
    covariance = covariance * SHARED**2
    sigma = np.degrees(np.sqrt(np.diag(covariance)))
    found = np.degrees(tilt)
    sound = np.isfinite(tilt).all() and np.abs(found).max() < MOST_DEG and sigma.max() < MOST_SIGMA_DEG
    if not sound:
        return camera, Tilt(pairs=len(rows))
    off = bool(tilt @ np.linalg.solve(covariance, tilt) > SIGNIFICANT * certain)
    report = Tilt(float(found[0]), float(found[1]), float(sigma[0]), float(sigma[1]), len(rows), off)
    return (tilted(camera, jnp.asarray(tilt)) if off else camera), report
