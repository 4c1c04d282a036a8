"""Where a robot is in a map that stands still: nothing is added to the map, and little is kept of the run.

A keyframe is compared with the map's keyframes alone. The closures of the last WINDOW keyframes that agree with each
other say where the robot is, the steps carry it on from there; what was believed longer ago says nothing any more, so
that a robot that was carried away is not held where it was.
"""

import dataclasses
import time
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from ebjax.geometry.camera import Camera
from ebjax.geometry.planar import between, compose, inverse
from ebjax.odometry.causal import LOST
from ebjax.odometry.steps import Steps
from ebjax.places.index import PlaceIndex
from ebjax.posegraph.robust import CHI2_99
from ebjax.slam.believe import KEPT
from ebjax.slam.config import PipelineConfig
from ebjax.slam.doubt import Doubt
from ebjax.slam.engine import correlating
from ebjax.slam.frame import Closure, Frame
from ebjax.slam.lean import Lean
from ebjax.slam.measured import Measured
from ebjax.slam.packed import Arrays, place_of
from ebjax.slam.path import SYSTEMATIC
from ebjax.slam.recall import Alike, best_of_each_way
from ebjax.slam.recording import Recording
from ebjax.slam.store import Store
from ebjax.slam.tied import Settled, Stretch, believed, fits, measured_well, moved_on, seen_in_map, tied
from ebjax.slam.walker import Remember
from ebjax.slam.walking import AcrossMap, Walking
from ebjax.views.run_view import RunView

WINDOW = 32
"""Closures of so many last keyframes count."""
START_SIGMA_M, START_SIGMA_DEG = 0.3, 10.0
"""How well a user knows where a robot starts."""
State = Literal["lost", "found"]


@dataclasses.dataclass(frozen=True)
class Whereabouts:
    """Where the robot is at a frame.

    Attributes:
      frame: its number.
      stamp_s: its time, s.
      keyframe: its number among the run's keyframes; None where it is none.
      map_from_base: x, y (m), heading (rad); None while it is lost.
      covariance: of that in its right tangent, seen from the map's settled keyframes; wider by a step that nothing
        measured while the path is in doubt; None while it is lost.
      map_from_odom: what brings odometry into the map (REP 105); None while it is lost or without wheels. It may jump.
      state: "found" from where closures agree, or from the start that was given, until the path breaks.
      nearest: row of the map's keyframe that the newest believed closure ties it to; None where none is left.
      closures: measured candidates whose standing is new; j is the frame in the run that the map knows it from.
      milliseconds: that `add` took.
    """

    frame: int
    stamp_s: float
    keyframe: int | None
    map_from_base: Float[np.ndarray, "3"] | None
    covariance: Float[np.ndarray, "3 3"] | None
    map_from_odom: Float[np.ndarray, "3"] | None
    state: State
    nearest: int | None
    closures: tuple[Closure, ...]
    milliseconds: float


class Localiser:
    """Says where the robot is in a map as it drives.

    Args:
      camera: of the images, as it is mounted.
      config: see there; the map was made with the same extractor, descriptor and weights.
      store: the map's keyframes; it is only read.
      poses: x, y (m), heading (rad) of each as settled; NaN for one that is not in the map's frame, as of a run that no
        closure joins to the first: it is not looked for.
      view: the floor that is looked at, as the map's runs did; None: what the camera sees well.
      recording: what of the run can be asked again.
      lean: how the robot leans at every frame, where that is known beforehand.
      remember: as of `Mapper`.
      start: about where the robot starts: x, y (m), heading (rad). None: it is lost until it recognises a place.

    Raises:
      ValueError: the map holds no keyframe in its frame, not as many poses as keyframes, or start is no pose; and as of
        `Mapper`.
    """

    def __init__(
        self,
        camera: Camera,
        config: PipelineConfig | None,
        store: Store,
        poses: Float[np.ndarray, "E 3"],
        *,
        view: RunView | None = None,
        recording: Recording | None = None,
        lean: Lean | None = None,
        remember: Remember | None = None,
        start: tuple[float, float, float] | None = None,
    ):
        if len(poses) != len(store):
            raise ValueError(f"{len(poses)} settled poses for {len(store)} keyframes of the map; give one of each")
        if np.isnan(poses).any(1).all():
            raise ValueError("the map holds no keyframe to look for: drive a run into it first")
        if start is not None and not np.isfinite(start).all():
            raise ValueError(f"start {start} is no pose: give x (m), y (m) and heading (rad)")
        ways = {"view": view, "recording": recording, "lean": lean, "remember": remember}
        self.walk = Walking(camera, config, **ways)
        self.config, self.store = self.walk.config, store
        self.looked = AcrossMap(store, len(store), self.walk)
        words = correlating(self.config)
        self.index = PlaceIndex() if words is None else PlaceIndex(words, self._maps)
        self.settled, self._map_frames = self._read(poses)
        self._known = np.isfinite(poses).all(1)
        self._pose: Float[np.ndarray, 3] | None = None
        self._covariance = np.diag(np.array([START_SIGMA_M, START_SIGMA_M, np.radians(START_SIGMA_DEG)]) ** 2)
        self._start = None if start is None else np.asarray(start, float)
        self._closures = _none()
        self._fitted = -1
        self._since = 0
        self._doubt = Doubt(self.walk.view.extent_m)
        self._nearest: int | None = None
        self._standing: dict[tuple[int, int, bool], str] = {}
        self._news: tuple[Closure, ...] = ()

    def _read(self, poses: Float[np.ndarray, "E 3"]) -> tuple[Settled, Int[np.ndarray, " E"]]:
        """Looks through the map once: its places, its frames, and how its steps err."""
        frames, steps = [], []
        for row in range(len(self.store)):
            kept = self.store.arrays(row)
            self.index.add(place_of(kept))
            frames.append(int(kept["at.frame"]))
            steps.append(self.store.settled_step(row, kept)[1])
        pieces = np.array([self.store.piece(row) for row in range(len(self.store))])
        on = np.flatnonzero((np.diff(pieces) == 0) & np.isfinite(np.diff(poses[:, 0])))
        if not len(on):
            return Settled(poses, 1.0, LOST), np.array(frames)
        way = np.linalg.norm(poses[on + 1, :2] - poses[on, :2], axis=1)
        sigma = np.median(np.diagonal(np.array(steps)[on + 1], axis1=1, axis2=2), axis=0)
        return Settled(poses, max(float(np.median(way)), 1e-3), SYSTEMATIC * np.diag(sigma)), np.array(frames)

    def _maps(self, rows: Int[np.ndarray, " K"]) -> tuple[np.ndarray, np.ndarray]:
        kept = [self.store.arrays(int(row)) for row in rows]
        return np.stack([k["place.map"] for k in kept]), np.stack([k["place.weight"] for k in kept])

    @property
    def state(self) -> State:
        """Whether the robot knows where it is."""
        return "lost" if self._pose is None else "found"

    def add(self, frame: Frame) -> Whereabouts:
        """Takes the next frame.

        Raises:
          ValueError: as of `Mapper.add`.
        """
        begun = time.perf_counter()
        self._news = ()
        keyframe = None
        for keyframe, kept, steps in self.walk.go_on(frame):
            self._arrived(keyframe, kept, steps)
        pose, covariance, from_odom = None, None, None
        if self._pose is not None:
            pose = compose(self._pose, self.walk.keyframe_from_base())
            covariance = self._covariance + (LOST if self._doubt else 0.0)
            if frame.odom_from_base is not None:
                from_odom = compose(pose, inverse(np.asarray(frame.odom_from_base, float)))
        return Whereabouts(
            len(self.walk.frames) - 1,
            frame.stamp_s,
            keyframe,
            pose,
            covariance,
            from_odom,
            self.state,
            self._nearest,
            self._news,
            1e3 * (time.perf_counter() - begun),
        )

    def _arrived(self, row: int, kept: Arrays, steps: Steps) -> None:
        """Looks for a keyframe in the map, and says whether the robot is where it was thought to be."""
        path, covariance = self.walk.chain.poses, self.walk.chain.covariance
        if row == 0:
            self._pose = self._start
        elif self._pose is not None:
            step = between(path[row - 1], path[row])
            self._pose = compose(self._pose, step)
            self._covariance = moved_on(self._covariance, step, SYSTEMATIC * covariance[row - 1])
        self._closures = _joined(_since(self._closures, row - WINDOW + 1), self._found_alike(row, kept))
        if self._pose is not None and self._fits(row, self._pose):
            self._fitted = row
        if row and self.config.motion != "wheels":
            self._doubt.go_on(row, steps, self._fitted == row)
        broken = self._broken(row)
        if broken is not None:
            self._pose, self._nearest, self._since = None, None, broken
            self._doubt.end()
        self._closures = _since(self._closures, self._since)
        self._believe(row, settle=broken is None)

    def _found_alike(self, row: int, kept: Arrays) -> Measured:
        """The keyframe's candidates in the map, measured."""
        found = self.index.query(place_of(kept), self._known, self._known)
        alike = Alike(np.asarray(found.j), np.asarray(found.opposing), np.asarray(found.distance))
        chosen = best_of_each_way(alike, np.ones(len(alike.j), bool), self.config.verify)
        if not len(chosen.j):
            return _none()
        i = np.full(len(chosen.j), row)
        pairs = self.looked.pairs(i + len(self.store), chosen.j, chosen.opposing)
        self.looked.told.clear()
        i_from_j, covariance, _ = pairs.measured(self.walk.camera, self.config.tolerance_m)
        ways = chosen.opposing, chosen.distance, pairs.inliers, pairs.total
        return Measured(i, chosen.j, *ways, i_from_j, covariance)

    def _fits(self, row: int, pose: Float[np.ndarray, "3"]) -> bool:
        """Whether a closure of the keyframe says what the path says."""
        believe = self.config.believe
        some = self._closures.rows(self._closures.i == row)
        some = some.rows(measured_well(some, believe))
        sigma = np.array([believe.max_sigma_m, believe.max_sigma_m, np.radians(believe.max_sigma_deg)])
        expected = self._covariance + np.diag(sigma**2)  # the map errs too
        return bool(fits(*seen_in_map(some, self.settled), pose, expected, CHI2_99[3]).any())

    def _broken(self, row: int) -> int | None:
        """The first keyframe since the path broke; None where it did not as far as is known."""
        keyframes, low = self.walk.keyframes, self._low(row)
        ways = np.diff(keyframes.travelled[low:]), np.diff(keyframes.stamp_s[low:])
        broken = self._doubt.broken(row, *ways)
        against = _since(self._closures, self._fitted + 1)
        if broken is not None or self._pose is None or not len(against.i):
            return broken
        kept = self._reasons(against, row) == KEPT
        return int(against.i[kept].min()) if kept.any() else None

    def _stretch(self, row: int) -> Stretch:
        low, walk = self._low(row), self.walk
        steps = SYSTEMATIC * walk.chain.covariance[low:row]
        return Stretch(walk.chain.poses[low:], steps, walk.keyframes.travelled[low:])

    def _low(self, row: int) -> int:
        return max(self._since, row - WINDOW + 1, 0)

    def _reasons(self, closures: Measured, row: int) -> np.ndarray:
        within = dataclasses.replace(closures, i=closures.i - self._low(row))
        return believed(within, self._stretch(row), self.settled, self.config.believe)

    def _believe(self, row: int, *, settle: bool) -> None:
        """Where the closures that agree say the keyframe is, and what is new of them."""
        closures = self._closures
        reasons = self._reasons(closures, row)
        kept = closures.rows(reasons == KEPT)
        self._nearest = int(kept.j[np.lexsort((kept.inliers, kept.i))[-1]]) if settle and len(kept.i) else None
        changed = [end for end, reason in self._standing.items() if reason == KEPT] != ends_of(kept)
        if settle and len(kept.i) and (changed or self._pose is None):
            self._fitted = row if self._pose is None else self._fitted
            within = dataclasses.replace(kept, i=kept.i - self._low(row))
            poses, self._covariance = tied(within, self._stretch(row), self.settled)
            self._pose = poses[-1]
        now = dict(zip(ends_of(closures), reasons.tolist(), strict=True))
        for k, (end, reason) in enumerate(now.items()):
            before = self._standing.get(end)
            if before is None or (before == KEPT) != (reason == KEPT):
                i, j, opposing = end
                frames = int(self.walk.keyframes.frame[i]), int(self._map_frames[j])
                rows = len(self.store) + i, j
                self._news += (Closure(*frames, opposing, closures.i_from_j[k], reason == KEPT, reason, rows),)
        self._standing = now


def ends_of(closures: Measured) -> list[tuple[int, int, bool]]:
    """What names each of some closures."""
    return list(zip(closures.i.tolist(), closures.j.tolist(), closures.opposing.tolist(), strict=True))


def _none() -> Measured:
    rows, flags, numbers = np.zeros(0, int), np.zeros(0, bool), np.zeros(0)
    return Measured(rows, rows, flags, numbers, rows, rows, np.zeros((0, 3)), np.zeros((0, 3, 3)))


def _since(closures: Measured, row: int) -> Measured:
    return closures.rows(closures.i >= row)


def _joined(one: Measured, other: Measured) -> Measured:
    names = [field.name for field in dataclasses.fields(Measured)]
    return Measured(*(np.concatenate([getattr(one, name), getattr(other, name)]) for name in names))
