"""Which measured candidates are loop closures, and why the others are not: asked anew as candidates come in.

In order: enough agreeing matches; a measurement that is certain enough; agreement with the odometry walked in between;
the best of each stretch of path; the largest set that agrees with itself (pairwise consistency), for every
`GROUP` closures along the path by themselves; the best `top` spread along the path. Every candidate has one reason.

What is believed is a function of the candidates and of the path between them alone, never of the order in which they
came or of what was believed before: a closure believed early is taken back where later ones contradict it.
"""

import dataclasses
from bisect import bisect_left
from collections.abc import Callable, Sequence
from itertools import count

import numpy as np
from jaxtyping import Bool, Float, Int

from ebjax.posegraph.consistency import largest_clique
from ebjax.slam.compared import ROOM, Compared
from ebjax.slam.gate import odometry_distance
from ebjax.slam.measured import Measured
from ebjax.slam.table import Table
from ebjax.slam.walked import Walked

KEPT = "kept"
THINNED = "a better closure is near on the path"
OUTVOTED = "contradicts the other closures"
CONTRADICTED = "contradicts the corrected path"
GROUP = ROOM // 2
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


class Belief:
    """What is believed of the candidates so far."""

    def __init__(self, config: BeliefConfig):
        self.config = config
        self._said = Table(reason=object, kept=bool)
        self._best: dict[int, tuple[float, int]] = {}
        """Of every stretch of path its best candidate: quality, row."""
        self._alive: dict[tuple[int, int], list[tuple[int, int]]] = {}
        """Of every two pieces of path the best candidates between them along it: later keyframe, row."""
        self._compared: dict[tuple[int, int], Compared] = {}

    @property
    def reasons(self) -> np.ndarray:
        """Of every candidate: "kept", or why not."""
        return self._said.reason

    @property
    def kept(self) -> Bool[np.ndarray, " K"]:
        """Which are loop closures."""
        return self._said.kept

    def update(self, candidates: Measured, path: Walked) -> None:
        """Asks again where what came in since the last time may change what is believed.

        Args:
          candidates: all so far, those of earlier updates first and unchanged; i and j are rows of the path.
          path: as it was at earlier updates, gone on.
        """
        old = len(self._said)
        new = candidates.rows(np.arange(old, len(candidates.i)))
        for reason in alone_reasons(new, path, self.config):
            self._said.append(reason=reason, kept=False)
        stretches = np.floor(path.travelled[new.i] / max(self.config.spacing_m, 1e-9)).astype(int)
        changed: dict[tuple[int, int], list[int]] = {}

        def change(row: int, how: Callable[[list[tuple[int, int]], tuple[int, int]], int]) -> None:
            i, j = int(candidates.i[row]), int(candidates.j[row])
            alive = self._alive.setdefault((int(path.piece[i]), int(path.piece[j])), [])
            was = changed.setdefault((int(path.piece[i]), int(path.piece[j])), [len(alive)])
            was.append(how(alive, (i, row)))

        for row, quality, stretch in zip(count(old), new.quality.tolist(), stretches.tolist(), strict=False):
            if self.reasons[row]:
                continue
            best = self._best.get(stretch)
            if best is not None and quality <= best[0]:
                self._say([row], THINNED)
                continue
            if best is not None:
                self._say([best[1]], THINNED)
                change(best[1], taken_out)
            self._best[stretch] = quality, row
            change(row, put_in)
        for pieces, (length, *places) in changed.items():
            # The last of the groups there were may now be two, or be no more.
            first = min(min(places) // GROUP, groups_of(length) - 1)
            self._groups(pieces, first, candidates, path)
        if self.config.top:
            self._spread_out(candidates, path)

    def _say(self, rows: Sequence[int] | Int[np.ndarray, " n"], reason: str) -> None:
        self._said.reason[rows], self._said.kept[rows] = reason, reason == KEPT

    def _groups(self, pieces: tuple[int, int], first: int, candidates: Measured, path: Walked) -> None:
        """Asks the closures between two pieces of path, from a group on, whether they agree."""
        alive = np.array([row for _, row in self._alive[pieces]], int)
        compared = self._compared.setdefault(pieces, Compared())
        many = groups_of(len(alive))
        for number in range(min(first, many - 1), many):
            group = alive[GROUP * number : None if number == many - 1 else GROUP * (number + 1)]
            agree = compared.agree(number, group, candidates, path)
            agreed = largest_clique(agree, candidates.rows(group).quality.astype(float))
            self._say(group[~agreed], OUTVOTED)
            group = group[agreed]
            supported = min(len(np.unique(candidates.i[group])), len(np.unique(candidates.j[group])))
            enough = supported >= self.config.min_agreeing
            self._say(group, KEPT if enough else "no other closure supports it")

    def _spread_out(self, candidates: Measured, path: Walked) -> None:
        """Keeps the best `top`, spread along the path, of all that are believed."""
        beyond = f"not among the best {self.config.top} spread along the path"
        self._say(np.flatnonzero(self.reasons == beyond), KEPT)
        believed = np.flatnonzero(self.kept)
        if len(believed) > self.config.top:
            some = candidates.rows(believed)
            chosen = spread_along(path.travelled[some.i], some.quality, self.config.top)
            self._say(believed[~chosen], beyond)


def groups_of(length: int) -> int:
    """How many groups so many closures make."""
    return max(1, length // GROUP)


def put_in(alive: list[tuple[int, int]], one: tuple[int, int]) -> int:
    """Where it went."""
    place = bisect_left(alive, one)
    alive.insert(place, one)
    return place


def taken_out(alive: list[tuple[int, int]], one: tuple[int, int]) -> int:
    """Where it was."""
    place = bisect_left(alive, one)
    del alive[place]
    return place


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
