"""The engine: a run frame by frame, each step from what is past.

    frame -> keyframe? -> describe -> steps to the keyframes before -> places alike -> verify -> believe -> correct

What decides are measurements and the path of their steps; `Mapper.finish` thinks the whole run over.
"""

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Float, Int, Int8, UInt8

from ebjax.features.extractor import extractor
from ebjax.features.remember import remembered
from ebjax.features.verify_pairs import stacked
from ebjax.geometry.camera import Camera
from ebjax.geometry.planar import between, compose, inverse
from ebjax.odometry.bridge import step_of
from ebjax.odometry.causal import Causal
from ebjax.odometry.floor_steps import more_certain, table_of
from ebjax.odometry.image_corners import image_corners
from ebjax.odometry.partners import REACH, partners_of_last
from ebjax.odometry.steps import Steps, joined, no_steps
from ebjax.places.descriptor import descriptor
from ebjax.places.fixed_words import FixedWords, fixed_words
from ebjax.places.index import PlaceIndex
from ebjax.places.place import placing
from ebjax.places.search import check_ranking
from ebjax.posegraph.graph import PoseGraph
from ebjax.slam.believe import Belief, Measured, Walked
from ebjax.slam.config import PipelineConfig
from ebjax.slam.correct import Corrector
from ebjax.slam.follow import Follower, LastFrames
from ebjax.slam.frame import Closure, Frame, Update
from ebjax.slam.graph import graph_so_far
from ebjax.slam.join import joined as into_one_frame
from ebjax.slam.lean import Lean, image_level, used
from ebjax.slam.look import Eyes, Looked
from ebjax.slam.packed import Arrays, packed, packed_place, place_of
from ebjax.slam.path import SYSTEMATIC
from ebjax.slam.recall import Alike, comparable_rows, worth_verifying
from ebjax.slam.recording import Recording
from ebjax.slam.store import Between, InMemory, Store, WithNewest
from ebjax.slam.table import Table
from ebjax.slam.told import packed_pairs, packed_steps, unpacked_pairs, unpacked_steps
from ebjax.views.run_view import RunView, choose_floor, from_camera

Remember = Callable[[str, Path | None], Callable[[Callable], Callable]]
METRES_PER_PX = 0.01


class Mapper:
    """Closes loops from opposing views as the robot drives.

    Args:
      camera: of the images, as it is mounted.
      config: see there.
      view: the floor that is looked at, or what chooses it for a camera; None: what the camera sees well.
      recording: what of the run can be asked again; None where it cannot, as on a robot.
      lean: how the robot leans at every frame, where that is known beforehand.
      remember: of a network's name and weights, gives what wraps its functions so that they look up what they know.
      store: where keyframes are kept; one that holds some is gone on with: frames up to its last keyframe, which is
        `next_frame`, are given to `pass_by`, those from there on to `add`. None: in memory.

    Raises:
      ValueError: wheels are asked for alone or not at all against what the frames have; an unknown descriptor or
        extractor; the camera sees no floor.
    """

    def __init__(
        self,
        camera: Camera,
        config: PipelineConfig | None = None,
        *,
        view: RunView | Callable[[Camera], RunView] | None = None,
        recording: Recording | None = None,
        lean: Lean | None = None,
        remember: Remember | None = None,
        store: Store | None = None,
    ):
        self.config = PipelineConfig() if config is None else config
        self.camera, self.recording, self.lean, self._remember = camera, recording, lean, remember
        networks = self.config.weights, self.config.arithmetic
        chosen, place = extractor(self.config.extractor, *networks), descriptor(self.config.descriptor, *networks)
        if remember is not None and not chosen.jitted:
            chosen = remembered(chosen, remember(self.config.extractor, chosen.weights))
        if remember is not None and not place.jitted:
            place = dataclasses.replace(place, look=remember(self.config.descriptor, place.weights)(place.look))
        self.view_of = view if callable(view) else lambda camera: view or default_view(camera)
        self.view = self.view_of(camera)
        self.eyes = Eyes(camera, self.view, chosen, place)
        self.store = WithNewest(InMemory() if store is None else store)
        self.looked = self._looked(self.store)
        self._place = placing(self.config.descriptor, self.config.weights)
        words = correlating(self.config)
        self.index = PlaceIndex() if words is None else PlaceIndex(words, self._maps)
        self.frames = Table(stamp_s=float, odom=(float, (3,)), row=int)
        self.names: list[str] = []
        self.broken: list[int] = []
        self.keyframes = Table(frame=int, stamp_s=float, odom=(float, (3,)), travelled=float, piece=int)
        self.firsts = Table(j=int, opposing=bool, distance=float)
        self.chain = Causal(self.config.odometry)
        self.bridged: list[Steps] = []
        self.candidates = Table(
            i=int, j=int, opposing=bool, distance=float, inliers=int, total=int, i_from_j=(float, (3,)),
            covariance=(float, (3, 3)),
        )  # fmt: skip
        self.belief = Belief(self.config.believe)
        self.corrector = Corrector()
        self.follower: Follower | None = None
        self.seconds: dict[str, float] = {}
        self._images: dict[int, tuple[np.ndarray, np.ndarray | None]] = {}
        self._asked: np.ndarray | None = None
        self._between: list[Between] = []
        self._in_map = self._begun_in_map = np.zeros(0, bool)
        pieces = [self.store.piece(row) for row in range(len(self.store))]
        self.start = sum(piece != self.store.current for piece in pieces)
        for row in range(len(self.store)):
            self._take_up(row, self.store.arrays(row))
        if len(self.candidates):
            self.belief.update(self.measured(), self.path)

    def _looked(self, store) -> Looked:
        turn, tolerance_m = self.eyes.extractor.turn, self.config.tolerance_m
        return Looked(store, self.view, self.camera, turn, tolerance_m, self.config.seed)

    @property
    def by_wheels(self) -> bool:
        """Whether odometry says which frames are keyframes."""
        return self.follower is None

    @property
    def path(self) -> Walked:
        """Of the keyframes before any closure."""
        return Walked(self.chain.poses, SYSTEMATIC * self.chain.covariance, self.keyframes.piece)

    def add(self, frame: Frame) -> Update:
        """Takes the next frame.

        Raises:
          ValueError: it is not later than the one before, is of another size than the camera's images, or has odometry
            where the ones before had none or the other way round.
        """
        begun = time.perf_counter()
        number = self._checked(frame)
        level = used(self.lean)
        due: list[tuple[int, Arrays]] = []
        if self.follower is not None:
            if frame.rgb is None:
                self.broken.append(number)
            else:
                kept = self._seen(frame, None if level is None else level[number])
                numbers = self.follower.add(number, frame.stamp_s, kept)
                due = [(one, self.follower.kept(one)) for one in numbers]
        elif self._moved(frame.odom_from_base):
            if frame.rgb is None:
                self.broken.append(number)
            else:
                due = [(number, self._seen(frame, None if level is None else level[number]))]
        if frame.rgb is not None:
            self._images[number] = frame.rgb, frame.depth_m
        closures: tuple[Closure, ...] = ()
        path = None
        for one, kept in due:
            news, corrected = self._keyframe(one, kept)
            closures += news
            path = self.corrector.poses(self.chain.poses) if corrected else path
        for old in [n for n in self._images if n < number - 1 and n != self._last_keyframe()]:
            del self._images[old]
        update = self._update(frame, number, bool(due), closures, path, begun)
        if number not in [one for one, _ in due] and len(self.keyframes) > self.start:
            self._between.append(Between(number, frame.stamp_s, frame.name, self._from_keyframe()))
        return update

    def _checked(self, frame: Frame) -> int:
        config, camera = self.config, self.camera
        if len(self.frames) and frame.stamp_s <= self.frames.stamp_s[-1]:
            raise ValueError(
                f"frame {frame.name or len(self.frames)} at {frame.stamp_s:.6f} s is not later than the one before, at "
                f"{self.frames.stamp_s[-1]:.6f} s; give the frames in the order of their times"
            )
        if frame.rgb is not None and frame.rgb.shape != (camera.height, camera.width, 3):
            raise ValueError(
                f"frame {frame.name or len(self.frames)} is an image of shape {frame.rgb.shape}, the camera's are "
                f"{(camera.height, camera.width, 3)}"
            )
        wheels = frame.odom_from_base
        if not len(self.frames):
            if wheels is None and config.motion not in (None, "floor"):
                raise ValueError(f"--motion {config.motion} needs odometry; run with --motion floor")
            if self.follower is None and (wheels is None or config.motion == "floor"):
                self._follow()
        elif (wheels is None) != bool(np.isnan(self.frames.odom[-1, 0])):
            raise ValueError(f"frame {frame.name or len(self.frames)}: some frames have odometry and some have none")
        return self._noted(frame)

    def _noted(self, frame: Frame) -> int:
        odom = np.full(3, np.nan) if frame.odom_from_base is None else np.asarray(frame.odom_from_base, float)
        self.names.append(frame.name)
        return self.frames.append(stamp_s=frame.stamp_s, odom=odom, row=-1)

    def _follow(self) -> None:
        """There are no wheels: the floor is followed from frame to frame."""
        last, config = LastFrames(), self.config
        limits = config.keyframe_m, config.keyframe_deg
        self.follower = Follower(self._looked(last), last, *limits, config.tolerance_m)

    def _moved(self, odom: Float[np.ndarray, "3"] | None) -> bool:
        """Whether the robot has moved or turned enough since the frame that was asked for last."""
        assert odom is not None
        if self._asked is not None:
            step = np.asarray(odom) - self._asked
            turn = abs(np.arctan2(np.sin(step[2]), np.cos(step[2])))
            far = np.hypot(step[0], step[1]) >= self.config.keyframe_m
            if not far and turn < np.radians(self.config.keyframe_deg):
                return False
        self._asked = np.asarray(odom, float)
        return True

    def _seen(self, frame: Frame, level: Float[np.ndarray, "4 4"] | None) -> Arrays:
        assert frame.rgb is not None
        described = self.eyes.describe(frame.rgb, frame.depth_m, level)
        described = jax.tree.map(np.asarray, described)
        return packed(described) | packed_place(self._place(described.place))

    def _maps(self, rows: Int[np.ndarray, " K"]) -> tuple[Int8[np.ndarray, "K h w D"], UInt8[np.ndarray, "K h w"]]:
        kept = [self.store.arrays(int(row)) for row in rows]
        return np.stack([k["place.map"] for k in kept]), np.stack([k["place.weight"] for k in kept])

    def _last_keyframe(self) -> int:
        return int(self.keyframes.frame[-1]) if len(self.keyframes) > self.start else -1

    def _arrived(self, number: int, kept: Arrays) -> int:
        """Hangs a keyframe on the path; returns its row."""
        row, self.store.newest = len(self.store), kept
        stamp_s, odom = self.frames.stamp_s[number], self.frames.odom[number]
        self.frames.row[number] = row
        self.keyframes.append(frame=number, stamp_s=stamp_s, odom=odom, travelled=0.0, piece=self.store.current)
        self._go_on(row, stamp_s)
        if row:
            step = np.linalg.norm(self.chain.poses[row, :2] - self.chain.poses[row - 1, :2])
            self.keyframes.travelled[row] = self.keyframes.travelled[row - 1] + step * (row > self.start)
        return row

    def _keyframe(self, number: int, kept: Arrays) -> tuple[tuple[Closure, ...], bool]:
        row = self._arrived(number, kept)
        alike = self._alike(row, kept)
        first = (alike.j[0], alike.opposing[0], alike.distance[0]) if len(alike.j) else (-1, False, np.inf)
        self.firsts.append(j=first[0], opposing=first[1], distance=first[2])
        path = self.path
        chosen = worth_verifying(alike, row, path, self.view, self.config)
        news = self._believe(row, chosen, path)
        self._keep(row, number)
        begun = self._begun_in_map
        corrected = self.corrector.take(row + 1, self._graph, self.chain.poses)
        self._in_map = begun if corrected else self._in_map
        return news, corrected

    def _way(self, first: int) -> Float[np.ndarray, "N 3"]:
        """Where keyframes from one on are thought to be before anything is fused: wheels, or the floor followed."""
        if self.follower is None:
            return self.keyframes.odom[first:]
        at = np.searchsorted(self.follower.frames, self.keyframes.frame[first:])
        return np.array(self.follower.poses)[at]

    def _go_on(self, row: int, stamp_s: float) -> None:
        """Measures the steps to the keyframe and adds it to the path."""
        wheels = self.follower is None
        self._steps = no_steps()
        if row == self.start:
            start = self.keyframes.odom[row] if wheels else np.zeros(3)
            return self.chain.begin(stamp_s, start)
        counted = self.keyframes.odom[row - 1 : row + 1] if wheels else None
        if self.config.motion == "wheels":
            steps = no_steps()
        else:
            first = max(self.start, row - REACH)
            j = first + partners_of_last(self.view, self._way(first))
            pairs = self.looked.pairs(np.full(len(j), row), j)
            steps = table_of(pairs, self.camera, self.config.tolerance_m)
            if not (steps.used & (steps.j == row - 1)).any():
                steps = joined([steps, self._bridge(row, stamp_s, counted)])
        self._steps = steps
        self.chain.go_on(stamp_s, steps, counted)

    def _bridge(self, row: int, stamp_s: float, wheels: Float[np.ndarray, "2 3"] | None) -> Steps:
        numbers = self.keyframes.frame[[row, row - 1]].tolist()
        level = image_level(self.lean)
        seen = None if self.recording is None or self.recording.ignored is None else ~self.recording.ignored
        corners = []
        for number in numbers:
            image = self._image(number)
            if image is None:
                return no_steps()
            corners.append(image_corners(*image, self.camera, seen, None if level is None else level[number]))
        guess = self.chain.expected(stamp_s)
        return step_of(row, row - 1, corners[0], corners[1], self.camera, wheels, guess, self.config.odometry)

    def _image(self, number: int) -> tuple[np.ndarray, np.ndarray | None] | None:
        again = None if self.recording is None else self.recording.load
        return self._images[number] if number in self._images else None if again is None else again(number)

    def _keep(self, row: int, number: int) -> None:
        """Keeps the keyframe in work with all that was measured of it."""
        firsts, keyframes = self.firsts, self.keyframes
        bridged = self._steps.kind == "image"
        steps = self._steps.rows(bridged | (self._steps.kind == "rotation"))
        if len(steps.i):
            self.bridged.append(steps)
        mine = self.candidates.i == row
        told = {
            "at.frame": np.array(number),
            "at.stamp_s": np.array(keyframes.stamp_s[row]),
            "at.odom": keyframes.odom[row].copy(),
            "at.travelled": np.array(keyframes.travelled[row]),
            "at.pose": self.chain.poses[row].copy(),
            "at.step": self.chain.steps[row].copy(),
            "at.measured": np.array(self.chain.measured[row]),
            "first": np.array([firsts.j[row], firsts.opposing[row], firsts.distance[row]]),
            "candidates": np.stack([self.candidates.j[mine], self.candidates.opposing[mine]], 1).astype(np.int64),
            "candidates.distance": self.candidates.distance[mine].copy(),
        }
        if self.follower is not None:
            told |= self.follower.told_up_to(number)
        whole = {**self.store.newest, **told, **packed_pairs(row, self.looked.told), **packed_steps(steps)}
        between, self._between = [one for one in self._between if one.frame < number], []
        self.store.keep(whole, self.names[number], between)

    def _take_up(self, row: int, kept: Arrays) -> None:
        """Goes on from a keyframe that was kept."""
        number, odom, piece = int(kept["at.frame"]), kept["at.odom"], self.store.piece(row)
        mine = row >= self.start
        if mine != (piece == self.store.current):
            raise ValueError(f"keyframe {row} of an earlier run lies among those of the one that goes on")
        if mine and self.follower is None and "follow.frames" in kept:
            self._follow()
        self.keyframes.append(
            frame=number, stamp_s=kept["at.stamp_s"], odom=odom, travelled=kept["at.travelled"], piece=piece
        )  # fmt: skip
        pose, step = (kept["at.pose"], kept["at.step"]) if mine else self.store.settled_step(row, kept)
        self.chain.take_up(float(kept["at.stamp_s"]), pose, step, bool(kept["at.measured"]))
        first = kept["first"]
        self.firsts.append(j=int(first[0]), opposing=bool(first[1]), distance=first[2])
        self.index.add(place_of(kept))
        self.looked.told |= unpacked_pairs(row, kept)
        if mine and len(kept["steps.words"]):
            self.bridged.append(unpacked_steps(kept))
        for (j, opposing), distance in zip(kept["candidates"].tolist(), kept["candidates.distance"], strict=True):
            self._candidate(row, j, bool(opposing), float(distance))
        if mine and self.follower is not None:
            self.follower.take_up(number, float(kept["at.stamp_s"]), kept)
        elif mine:
            self._asked = odom.copy()

    def _candidate(self, row: int, j: int, opposing: bool, distance: float) -> None:
        inliers, total, settled = self.looked.told[row, j, opposing]
        i_from_j, covariance, _ = more_certain(stacked([settled]), False)
        self.candidates.append(
            i=row, j=j, opposing=opposing, distance=distance, inliers=inliers, total=total, i_from_j=i_from_j[0],
            covariance=covariance[0],
        )  # fmt: skip

    @property
    def numbers(self) -> Int[np.ndarray, " n"]:
        """The frames that are keyframes, without those of earlier runs."""
        return self.keyframes.frame[self.start :]

    @property
    def next_frame(self) -> int:
        """The number of the first frame that `add` has not seen, where a store is gone on with."""
        return self._last_keyframe() + 1

    def pass_by(self, frame: Frame) -> None:
        """Takes a frame that was added before the store was left; its image is not looked at."""
        number = self._noted(frame)
        rows = self.start + np.flatnonzero(self.keyframes.frame[self.start :] == number)
        self.frames.row[number] = rows[0] if len(rows) else -1

    def _alike(self, row: int, kept: Arrays) -> Alike:
        place = place_of(kept)
        config = self.config
        same, opposing = comparable_rows(
            self.keyframes.stamp_s, self.keyframes.travelled, self.start, config.min_gap_s, config.min_gap_m
        )
        found = self.index.query(place, same, opposing)
        self.index.add(place)
        return Alike(np.asarray(found.j), np.asarray(found.opposing), np.asarray(found.distance))

    def _believe(self, row: int, chosen: Alike, path: Walked) -> tuple[Closure, ...]:
        count = len(self.candidates)
        if len(chosen.j):
            i = np.full(len(chosen.j), row)
            self.looked.pairs(i, chosen.j, chosen.opposing)
            for j, opposing, distance in zip(chosen.j, chosen.opposing, chosen.distance, strict=True):
                self._candidate(row, int(j), bool(opposing), float(distance))
            before = self.belief.kept
            self.belief.update(self.measured(), path)
            after = self.belief.kept
            changed = np.flatnonzero(np.append(before, np.zeros(len(after) - len(before), bool)) != after)
            return tuple(self._closure(int(k)) for k in np.union1d(changed, np.arange(count, len(after))))
        return ()

    def way_everywhere(self) -> Float[np.ndarray, "F 3"]:
        """Wheels, or the floor followed, at all frames."""
        return self.frames.odom if self.follower is None else self.follower.everywhere(len(self.frames))

    def bridged_steps(self) -> Steps:
        """Steps that whole images measured."""
        return joined(self.bridged) if self.bridged else no_steps()

    def measured(self) -> Measured:
        """All candidates so far; i and j are rows of the keyframes."""
        names = [field.name for field in dataclasses.fields(Measured)]
        return Measured(*(getattr(self.candidates, name).copy() for name in names))

    def _closure(self, k: int) -> Closure:
        c, frame = self.candidates, self.keyframes.frame
        reason = str(self.belief.reasons[k])
        ends = int(frame[c.i[k]]), int(frame[c.j[k]])
        rows = int(c.i[k]), int(c.j[k])
        return Closure(*ends, bool(c.opposing[k]), c.i_from_j[k].copy(), bool(self.belief.kept[k]), reason, rows)

    def _graph(self, poses: Float[np.ndarray, "N 3"]) -> PoseGraph:
        kept = self.measured().rows(np.flatnonzero(self.belief.kept))
        start, self._begun_in_map = into_one_frame(poses, self.keyframes.piece, kept)
        return graph_so_far(self.chain.poses, self.chain.covariance, self.keyframes.piece, start, kept)

    def _from_keyframe(self) -> Float[np.ndarray, "3"]:
        """The last frame, from the last keyframe, by wheels or the floor followed."""
        if self.follower is None:
            return between(self.keyframes.odom[-1], self.frames.odom[-1])
        return between(self.follower.pose_of(self._last_keyframe()), self.follower.poses[-1])

    def _update(self, frame: Frame, number: int, keyframe: bool, closures, path, begun: float) -> Update:
        rows = len(self.chain)
        pose, covariance = np.zeros(3), np.eye(3)
        if rows > self.start:
            pose = compose(self.corrector.last(self.chain.poses), self._from_keyframe())
            covariance = self.chain.spread_since(max(self.corrector.settled - 1, 0))
        odom = frame.odom_from_base
        return Update(
            number,
            frame.stamp_s,
            rows - 1 if keyframe else None,
            pose,
            not self.start or bool(len(self._in_map) > self.start and self._in_map[self.start]),
            None if odom is None else compose(pose, inverse(np.asarray(odom, float))),
            covariance,
            closures,
            path,
            self.looked.seen(rows - 1) if keyframe else None,
            1e3 * (time.perf_counter() - begun),
        )


def correlating(config: PipelineConfig) -> FixedWords | None:
    """The words whose maps are correlated; None where places are ranked by cosine alone.

    Raises:
      ValueError: maps are to be correlated and the descriptor has none.
    """
    place = descriptor(config.descriptor, config.weights, config.arithmetic)
    check_ranking(config.ranking, place.has_maps)
    if config.ranking == "cosine" or not place.has_maps:
        return None
    name = "floornet" if config.descriptor == "joint" else config.descriptor
    return fixed_words(name, config.weights)


def default_view(camera: Camera) -> RunView:
    """The floor that a camera sees well, 1 cm a pixel."""
    return from_camera(camera, choose_floor(camera, METRES_PER_PX))
