"""Which measured candidates are loop closures, and why the others are not: asked anew as candidates come in.

In order: enough agreeing matches; a measurement that is certain enough; agreement with the odometry walked in between;
the best of each stretch of path; the largest set that agrees with itself (pairwise consistency), for every
`GROUP` closures along the path by themselves; the best `top` spread along the path. Every candidate has one reason.

What is believed is a function of the candidates and of the path between them alone, never of the order in which they
came or of what was believed before: a closure believed early is taken back where later ones contradict it.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ebjax.geometry.planar import adjoint, inverse, inverse_covariance
from ebjax.posegraph.consistency import Loops, cycle, largest_clique
from ebjax.posegraph.robust import CHI2_99
from ebjax.slam.gate import odometry_distance

KEPT = "kept"
THINNED = "a better closure is near on the path"
CONTRADICTED = "contradicts the corrected path"
GROUP = 64
"""Closures that are compared with each other, at least; the last of a path are up to twice as many."""


@dataclasses.dataclass(frozen=True)
class BeliefConfig:
    """When a measured candidate is believed."""

    min_inliers: int = 20
    """Matches that agree on one motion, at least."""
    min_inlier_ratio: float = 0.4
    """Share of the matches that agree, at least: repeated tiles make many agree on a wrong motion, but not most."""
    max_sigma_m: float = 0.03
    """Largest standard deviation of the measured position, m."""
    max_sigma_deg: float = 0.5
    """Largest standard deviation of the measured heading, degrees."""
    odometry_sigmas: float = 4.0
    """How far a closure may contradict the odometry between its ends, in that odometry's standard deviations."""
    min_agreeing: int = 2
    """Closures of so many different views must agree with each other, or none is kept: one view may be an alias."""
    spacing_m: float = 0.4
    """One closure at most for so much path, the one with most agreeing matches."""
    top: int = 0
    """Keep only so many closures, spread along the path, as the paper's 20; 0 keeps all."""


@dataclasses.dataclass(frozen=True)
class Measured:
    """Measured candidates, one a row: i > j, direction, distance of the descriptors, matches, motion."""

    i: Int[np.ndarray, " K"]
    j: Int[np.ndarray, " K"]
    opposing: Bool[np.ndarray, " K"]
    distance: Float[np.ndarray, " K"]
    inliers: Int[np.ndarray, " K"]
    total: Int[np.ndarray, " K"]
    i_from_j: Float[np.ndarray, "K 3"]
    covariance: Float[np.ndarray, "K 3 3"]

    def rows(self, which: np.ndarray) -> "Measured":
        """Some of them."""
        return Measured(*(getattr(self, field.name)[which] for field in dataclasses.fields(self)))


@dataclasses.dataclass(frozen=True)
class Walked:
    """The path that candidates are compared with, and how it may err.

    Attributes:
      poses: x, y (m), heading (rad) of the keyframes.
      steps: covariance of each of the N - 1 steps, right tangent.
      piece: which unbroken piece of path a keyframe belongs to; nothing is known between two pieces.
    """

    poses: Float[np.ndarray, "N 3"]
    steps: Float[np.ndarray, "M 3 3"]
    piece: Int[np.ndarray, " N"]

    def travelled(self) -> Float[np.ndarray, " N"]:
        """The way to every keyframe, m."""
        steps = np.linalg.norm(np.diff(self.poses[:, :2], axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(np.where(np.diff(self.piece) == 0, steps, 0.0))])

    def spread(self) -> Float[np.ndarray, "N 3 3"]:
        """C_n = sum Ad Q Ad^T: the odometry from m to n has covariance C_n - C_m, in the world."""
        ad = adjoint(self.poses[1:])
        return np.concatenate([np.zeros((1, 3, 3)), np.cumsum(ad @ self.steps @ np.swapaxes(ad, 1, 2), 0)])


class Belief:
    """What is believed of the candidates so far.

    Attributes:
      reasons: "kept", or why not, of every candidate.
    """

    def __init__(self, config: BeliefConfig):
        self.config, self.reasons = config, np.zeros(0, object)
        self._alone = np.zeros(0, object)
        self._agree: dict[tuple[int, int], bool] = {}
        self._cliques: dict[tuple[int, ...], Bool[np.ndarray, " n"]] = {}
        self._known = self._cliques

    @property
    def kept(self) -> Bool[np.ndarray, " K"]:
        """Which are loop closures."""
        return self.reasons == KEPT

    def update(self, candidates: Measured, path: Walked) -> None:
        """Asks again.

        Args:
          candidates: all so far, those of earlier updates first and unchanged; i and j are rows of the path.
          path: as it was at earlier updates, gone on.
        """
        old = len(self.reasons)
        alone = alone_reasons(candidates.rows(np.arange(old, len(candidates.i))), path, self.config)
        self._alone = np.concatenate([self._alone, alone])
        self.reasons = self._alone.copy()
        alive = np.flatnonzero(self._alone == "")
        quality = candidates.inliers**2 / np.maximum(candidates.total, 1)
        place = path.travelled()[candidates.i]
        best = best_per_stretch(place[alive], quality[alive], self.config.spacing_m)
        self.reasons[alive[~best]] = THINNED
        alive = alive[best]
        pairs = np.stack([path.piece[candidates.i[alive]], path.piece[candidates.j[alive]]], 1)
        self._known, self._cliques = self._cliques, {}
        for pair in np.unique(pairs, axis=0):
            self._groups(alive[(pairs == pair).all(1)], candidates, path, quality)
        top = self.config.top
        alive = np.flatnonzero(self.reasons == KEPT)
        if top and len(alive) > top:
            spread = spread_along(place[alive], quality[alive], top)
            self.reasons[alive[~spread]] = f"not among the best {top} spread along the path"

    def _groups(self, alive: Int[np.ndarray, " n"], candidates: Measured, path: Walked, quality) -> None:
        alive = alive[np.lexsort((candidates.j[alive], candidates.i[alive]))]
        starts = [GROUP * k for k in range(max(1, len(alive) // GROUP))]
        for start, end in zip(starts, [*starts[1:], len(alive)], strict=True):
            group = alive[start:end]
            agreed = self._clique(group, candidates, path, quality)
            self.reasons[group[~agreed]] = "contradicts the other closures"
            group = group[agreed]
            supported = min(len(np.unique(candidates.i[group])), len(np.unique(candidates.j[group])))
            enough = supported >= self.config.min_agreeing
            self.reasons[group] = KEPT if enough else "no other closure supports it"

    def _clique(self, group, candidates: Measured, path: Walked, quality) -> Bool[np.ndarray, " n"]:
        key = tuple(group.tolist())
        if key in self._known:
            self._cliques[key] = self._known[key]
        if key not in self._cliques:
            lacking = {a: sum((a, b) not in self._agree for b in key) for a in key}
            loops = loops_of(candidates.rows(group), path) if any(lacking.values()) else None
            # One closure that is new lacks all others, and each of these only the new one.
            while loops is not None and any(lacking.values()):
                a = max(key, key=lambda k: lacking[k])
                ways = np.asarray(_row_of_cycles(loops, key.index(a)))[:, : len(key)] <= CHI2_99[3]
                for b, one, other in zip(key, *ways, strict=True):
                    lacking[b] -= (a, b) not in self._agree and a != b
                    self._agree[a, b] = self._agree[b, a] = bool(one and other)
                lacking[a] = 0
            agree = np.array([[self._agree[a, b] for b in key] for a in key]).reshape(len(key), len(key))
            self._cliques[key] = largest_clique(agree, quality[group].astype(float))
        return self._cliques[key]


def alone_reasons(candidates: Measured, path: Walked, config: BeliefConfig) -> np.ndarray:
    """Why each candidate by itself is not believed; "" where nothing speaks against it."""
    reasons = np.full(len(candidates.i), "", object)

    def reject(rows, why):
        for k in np.flatnonzero(rows):
            if not reasons[k]:
                reasons[k] = why(k) if callable(why) else why

    ratio = candidates.inliers / np.maximum(candidates.total, 1)
    reject(
        candidates.inliers < config.min_inliers,
        lambda k: f"{candidates.inliers[k]} inliers, fewer than {config.min_inliers}",
    )
    reject(
        ratio < config.min_inlier_ratio,
        lambda k: f"inlier ratio {ratio[k]:.2f}, below {config.min_inlier_ratio:g}",
    )
    sigma = np.sqrt(np.maximum(np.diagonal(candidates.covariance, axis1=1, axis2=2), 0))
    reject(~np.isfinite(candidates.i_from_j).all(1) | ~np.isfinite(sigma).all(1), "no measurement: too little depth")
    reject(
        (sigma[:, :2].max(1, initial=0) > config.max_sigma_m) | (np.degrees(sigma[:, 2]) > config.max_sigma_deg),
        lambda k: f"uncertain: {sigma[k, :2].max():.3f} m, {np.degrees(sigma[k, 2]):.2f} deg",
    )
    walked = (path.piece[candidates.i] == path.piece[candidates.j]) & (reasons == "")
    some = candidates.rows(walked)
    off = np.zeros(len(reasons))
    off[walked] = odometry_distance(some.i, some.j, some.i_from_j, some.covariance, path.poses, path.steps)
    reject(off > config.odometry_sigmas, lambda k: f"contradicts odometry by {off[k]:.1f} sigma")
    return reasons


def loops_of(group: Measured, path: Walked) -> Loops:
    """Closures and the path at their ends, as `posegraph.consistency` compares them, in arrays of one size."""
    count, room = len(group.i), 2 * GROUP
    # Rows in the order of the path: which of two comes first says whether the way between adds or is taken away.
    ends = np.unique(np.concatenate([group.j, group.i]))
    poses, spread = np.zeros((2 * room, 3)), np.zeros((2 * room, 3, 3))
    poses[: len(ends)], spread[: len(ends)] = path.poses[ends], path.spread()[ends]
    earlier, later = np.zeros(room, int), np.zeros(room, int)
    earlier[:count], later[:count] = np.searchsorted(ends, group.j), np.searchsorted(ends, group.i)
    measured, covariance = np.zeros((room, 3)), np.tile(np.eye(3), (room, 1, 1))
    measured[:count] = inverse(group.i_from_j)
    covariance[:count] = inverse_covariance(group.i_from_j, group.covariance)
    return Loops(poses, spread, earlier, later, measured, covariance)


@jax.jit
def _row_of_cycles(loops: Loops, a: Int[Array, ""]) -> Float[Array, "2 K"]:
    """Distances of the cycles through closure a and every other, and through every other and a."""
    every = jnp.arange(len(loops.i))
    one = jnp.broadcast_to(a, every.shape)
    return jnp.stack([cycle(loops, one, every)[0], cycle(loops, every, one)[0]])


def best_per_stretch(
    place: Float[np.ndarray, " K"], quality: Float[np.ndarray, " K"], spacing: float
) -> Bool[np.ndarray, " K"]:
    """The best of every stretch of `spacing`, the path cut from its start."""
    chosen = np.zeros(len(place), bool)
    stretch = np.floor(place / max(spacing, 1e-9)).astype(int)
    order = np.lexsort((np.arange(len(place)), -quality, stretch))
    first = np.append(True, np.diff(stretch[order]) != 0)[: len(order)]
    chosen[order[first]] = True
    return chosen


def spread_along(place: Float[np.ndarray, " K"], quality: Float[np.ndarray, " K"], top: int) -> Bool[np.ndarray, " K"]:
    """The best of each of `top` equal stretches of path, the free places filled with the best that are left."""
    edges = np.linspace(place.min(), place.max() + 1e-9, top + 1)
    stretch = np.searchsorted(edges, place, side="right") - 1
    chosen = np.zeros(len(place), bool)
    order = np.argsort(-quality, kind="stable")
    for k in order:
        chosen[k] = not chosen[stretch == stretch[k]].any()
    for k in order:
        if chosen.sum() >= top:
            break
        chosen[k] = True
    return chosen
