"""The offset between two clocks, from how both recordings move: distances and turns within a window need no frame.

Normalised cross-correlation along time gives candidates. The one at which a similarity leaves the least distance
between the paths wins, and is refined to where the motions correlate best.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ebjax.evaluation.trajectory import align_sim3
from ebjax.io.clocks import median_spacing
from ebjax.io.poses import interpolate
from ebjax.io.timed_poses import nearest
from ebjax.io.trajectory import Trajectory

WINDOW_STEPS = 10
"""Steps within which motion is measured: over one step it would be noise."""
MOST_STEPS = 30_000
MOST_POINTS = 1_000
CANDIDATES = 5
LEAST_CORRELATION = 0.6
"""Of the motions: other drives correlate by half at some lag."""
LEAST_OVERLAP = 0.5
LEAST_VARIATION = 0.05
"""Standard deviation against mean of a motion that tells one moment from another."""
STILL_M = 1e-6
COINCIDENT, WITHIN = 0.01, 0.1
"""Samples of both lie on each other, by these parts of a step."""


@dataclass(frozen=True)
class Offset:
    """What to add to an estimate's times.

    Attributes:
      seconds: the offset.
      disagreement: rms distance of the paths after a similarity, against the reference's spread; 0 is alike.
    """

    seconds: float
    disagreement: float


def find_offset(reference: Trajectory, estimate: Trajectory) -> Offset | None:
    """Finds the constant offset of the estimate's clock at which both trajectories move alike.

    Args:
      reference: timed poses.
      estimate: timed poses; half of the shorter recording at least must overlap with the other.

    Returns:
      None where a trajectory has fewer than four instants or never moves, and where nothing tells one moment from
      another: a path at constant speed, unless both recordings are equally long.
    """
    a, b = _Path.of(reference), _Path.of(estimate)
    if a is None or b is None:
        return None
    # No finer than the coarser of the two, and no more steps than a Fourier transform takes in a blink.
    step = max(a.spacing, b.spacing, max(a.length, b.length) / MOST_STEPS)
    window = max(min(WINDOW_STEPS * step, min(a.length, b.length) / 8), step)
    lags = _correlated_lags(a, b, step, window)
    if abs(a.length - b.length) <= 2 * step and not any(abs(lag) <= 3 * step for lag in lags):
        # Two recordings of one length may well have begun together.
        lags.append(0.0)
    left, lag = min(((_disagreement(a, b, lag), lag) for lag in lags), default=(np.inf, 0.0))
    if not np.isfinite(left):
        return None
    lag = _on_samples(a, b, _refined(a, b, lag, step, window), step)
    return Offset(float(reference.timestamps[0] - estimate.timestamps[0] + lag), _disagreement(a, b, lag))


def disagreement(reference: Trajectory, estimate: Trajectory, offset_s: float) -> float:
    """`Offset.disagreement` at a given offset; infinite where less than half of the shorter recording overlaps."""
    a, b = _Path.of(reference), _Path.of(estimate)
    if a is None or b is None:
        return float("inf")
    return _disagreement(a, b, offset_s - float(reference.timestamps[0] - estimate.timestamps[0]))


@dataclass(frozen=True)
class _Path:
    """A trajectory whose times count from its own start."""

    times: Float[np.ndarray, " N"]
    poses: Float[np.ndarray, "N 4 4"]

    @classmethod
    def of(cls, trajectory: Trajectory) -> "_Path | None":
        times, rows = np.unique(trajectory.timestamps, return_index=True)
        times, poses = times - times[0], trajectory.poses[rows]
        if len(times) < 4 or np.ptp(poses[:, :3, 3], axis=0).max() < STILL_M:
            return None
        return cls(times, poses)

    @property
    def length(self) -> float:
        return float(self.times[-1])

    @property
    def spacing(self) -> float:
        return median_spacing(self.times)

    def positions(self, times: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(times, self.times, self.poses[:, k, 3]) for k in range(3)], axis=1)

    def motion(self, starts: np.ndarray, window: float) -> tuple[np.ndarray, np.ndarray]:
        """Distance (m) and turn (rad) from each start to a window later; times beyond an end stand at the end."""
        first, last = self.at(starts), self.at(starts + window)
        moved = np.linalg.norm(last[:, :3, 3] - first[:, :3, 3], axis=1)
        cosine = (np.einsum("nij,nij->n", first[:, :3, :3], last[:, :3, :3]) - 1) / 2
        return moved, np.arccos(np.clip(cosine, -1, 1))

    def at(self, times: np.ndarray) -> np.ndarray:
        times = np.clip(times, 0.0, self.length)
        after = np.clip(np.searchsorted(self.times, times, side="right"), 1, len(self.times) - 1)
        share = (times - self.times[after - 1]) / (self.times[after] - self.times[after - 1])
        return interpolate(self.poses[after - 1], self.poses[after], share)


def _tells(signal: np.ndarray) -> bool:
    return bool(np.std(signal) > LEAST_VARIATION * max(np.mean(signal), 1e-9))


def _correlated_lags(a: _Path, b: _Path, step: float, window: float) -> list[float]:
    """Where the normalised cross-correlation of the motions peaks, s from start to start, best first."""
    motions = [path.motion(np.arange(0.0, path.length - window + step / 2, step), window) for path in (a, b)]
    scores = [_correlation(x, y) for x, y in zip(*motions, strict=True) if _tells(x) and _tells(y)]
    if not scores:
        return []
    score = np.mean(scores, axis=0)
    padded = np.concatenate([[-np.inf], score, [-np.inf]])
    peaks = np.flatnonzero((score >= padded[:-2]) & (score >= padded[2:]) & (score >= LEAST_CORRELATION))
    best = peaks[np.argsort(-score[peaks], kind="stable")[:CANDIDATES]]
    return [float(k - (len(motions[1][0]) - 1)) * step for k in best]


def _correlation(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Pearson's r of what overlaps of x and y at every lag; -1 where less than half of the shorter overlaps."""
    x, y = x - x.mean(), y - y.mean()
    in_x, in_y = np.ones_like(x), np.ones_like(y)

    size = len(x) + len(y) - 1

    def slide(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        return np.fft.irfft(np.fft.rfft(p, size) * np.fft.rfft(q[::-1], size), size)

    n = np.maximum(np.round(slide(in_x, in_y)), 1)
    sum_x, sum_y = slide(x, in_y), slide(in_x, y)
    var_x = np.maximum(slide(x**2, in_y) - sum_x**2 / n, 0)
    var_y = np.maximum(slide(in_x, y**2) - sum_y**2 / n, 0)
    scale = np.sqrt(var_x * var_y)
    r = (slide(x, y) - sum_x * sum_y / n) / np.maximum(scale, 1e-6 * scale.max())
    return np.where(n >= LEAST_OVERLAP * min(len(x), len(y)), r, -1.0)


def _disagreement(a: _Path, b: _Path, lag: float) -> float:
    """Rms distance after a similarity where both paths are known, against the spread of the reference there."""
    rows = _spread(len(b.times))
    times = b.times[rows] + lag
    inside = (times >= -1e-6) & (times <= a.length + 1e-6)
    common = min(a.length, b.length + lag) - max(0.0, lag)
    if inside.sum() < 4 or common < 0.99 * LEAST_OVERLAP * min(a.length, b.length):
        return float("inf")
    target, source = a.positions(times[inside]), b.poses[rows[inside], :3, 3]
    spread = np.sqrt(np.mean(np.sum((target - target.mean(axis=0, keepdims=True)) ** 2, axis=1)))
    if spread < STILL_M or np.ptp(source, axis=0).max() < STILL_M:
        return float("inf")
    matrix = align_sim3(source, target)
    error = target - source @ matrix[:3, :3].T - matrix[None, :3, 3]
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))) / spread)


def _refined(a: _Path, b: _Path, lag: float, step: float, window: float) -> float:
    """The lag within a step and a half at which the motion that correlates better does so best, by a parabola.

    Motions, not positions: drift bends a path, but hardly what it does within a window.
    """
    starts = b.times[_spread(len(b.times))]
    starts = starts[
        (starts + window <= b.length) & (starts + lag >= -step) & (starts + lag + window <= a.length + step)
    ]
    if len(starts) < 4:
        return lag
    there = b.motion(starts, window)
    shifts = np.linspace(-1.5, 1.5, 25) * step
    motions = [a.motion(starts + lag + shift, window) for shift in shifts]
    found: list[tuple[float, float]] = []
    for k, y in enumerate(there):
        here = [motion[k] for motion in motions]
        if _tells(y) and all(_tells(x) for x in here):
            found.append(_peak(shifts, np.array([np.corrcoef(x, y)[0, 1] for x in here])))
    return lag + max(found)[1] if found else lag


def _peak(places: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """The largest value and its place, by a parabola through its neighbours."""
    k = int(np.argmax(values))
    if not 0 < k < len(values) - 1:
        return float(values[k]), float(places[k])
    before, here, after = values[k - 1 : k + 2]
    bend = before - 2 * here + after
    shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return float(here), float(places[k] + shift * (places[1] - places[0]))


def _spread(count: int) -> np.ndarray:
    return np.unique(np.linspace(0, count - 1, MOST_POINTS).round().astype(int))


def _on_samples(a: _Path, b: _Path, lag: float, step: float) -> float:
    """The lag at which the samples of both coincide in time, where that is a small part of a step away."""
    apart = a.times[nearest(a.times, b.times + lag)] - (b.times + lag)
    shift = float(np.median(apart))
    coincide = np.median(np.abs(apart - shift)) < COINCIDENT * step
    return lag + shift if coincide and abs(shift) < WITHIN * step else lag
