"""A run's frames, which of them are keyframes, how these look, and the path of their steps: what engines stand on."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Float, Int

from ebjax.features.extractor import extractor
from ebjax.features.remember import remembered
from ebjax.geometry.camera import Camera
from ebjax.geometry.planar import between
from ebjax.odometry.bridge import step_of
from ebjax.odometry.causal import Causal
from ebjax.odometry.floor_steps import table_of
from ebjax.odometry.image_corners import image_corners
from ebjax.odometry.image_matches import LONGEST_SIDE, QUICK_SIDE, ImageFeatures
from ebjax.odometry.partners import REACH, partners_of_last
from ebjax.odometry.steps import Steps, joined, no_steps
from ebjax.places.descriptor import descriptor
from ebjax.places.place import placing
from ebjax.slam import pauses
from ebjax.slam.ahead import Ahead
from ebjax.slam.check_frame import check_frame
from ebjax.slam.config import PipelineConfig
from ebjax.slam.follow import Follower, LastFrames
from ebjax.slam.frame import Frame
from ebjax.slam.lean import Lean, image_level, used
from ebjax.slam.look import Eyes, Looked
from ebjax.slam.packed import Arrays, packed, packed_place
from ebjax.slam.path import SYSTEMATIC
from ebjax.slam.recording import Recording
from ebjax.slam.store import Between, InMemory, Shelf, Store, WithNewest
from ebjax.slam.table import Table
from ebjax.slam.walked import Walked
from ebjax.views.run_view import RunView, choose_floor, from_camera

Remember = Callable[[str, Path | None], Callable[[Callable], Callable]]
"""Of a network's name and weights, what wraps its functions so that they look up what they know."""
METRES_PER_PX = 0.01


class Walker:
    """Takes frames and hangs the keyframes among them on the path, each on the one before.

    Attributes:
      frames: all so far; `odom` is NaN without wheels, `row` the keyframe's or -1.
      keyframes: by row, those of earlier runs in the store first.
      start: how many of these there are.
      chain: the path by the steps alone.
      looked: the keyframes' features and what pairs of them have in common.
      follower: what follows the floor from frame to frame; None with wheels.
      broken: frames that were due and could not be read.
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
        """See `ebjax.slam.mapper.Mapper`."""
        self.config = PipelineConfig() if config is None else config
        self.camera, self.recording, self.lean, self.remember = camera, recording, lean, remember
        networks = self.config.weights, self.config.arithmetic
        chosen, place = extractor(self.config.extractor, *networks), descriptor(self.config.descriptor, *networks)
        pauses.keep_short()
        if remember is not None and not chosen.jitted:
            chosen = remembered(chosen, remember(self.config.extractor, chosen.weights))
        if remember is not None and not place.jitted:
            place = dataclasses.replace(place, look=remember(self.config.descriptor, place.weights)(place.look))
        self.view_of = view if callable(view) else lambda camera: view or default_view(camera)
        self.view = self.view_of(camera)
        self.eyes = Eyes(camera, self.view, chosen, place)
        self.place = placing(self.config.descriptor, self.config.weights)
        self.store = WithNewest(InMemory() if store is None else store)
        self.looked = self._looked(self.store)
        self.frames = Table(stamp_s=float, odom=(float, (3,)), row=int)
        self.names: list[str] = []
        self.broken: list[int] = []
        self.keyframes = Table(frame=int, stamp_s=float, odom=(float, (3,)), travelled=float, piece=int)
        pieces = [self.store.piece(row) for row in range(len(self.store))]
        self.start = sum(piece != self.store.current for piece in pieces)
        self.chain = Causal(self.config.odometry)
        self._path = Walked(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0, int))
        self.bridged: list[Steps] = []
        self.follower: Follower | None = None
        self._steps = no_steps()
        self._images: dict[int, Frame] = {}
        self._ahead = Ahead()
        self._corners: dict[int, ImageFeatures] = {}
        self._asked: np.ndarray | None = None
        self._between: list[Between] = []

    def _looked(self, store: Shelf) -> Looked:
        turn, tolerance_m = self.eyes.extractor.turn, self.config.tolerance_m
        return Looked(store, self.view, self.camera, turn, tolerance_m, self.config.seed)

    @property
    def path(self) -> Walked:
        """Of the keyframes before any closure."""
        piece = self.keyframes.piece
        if len(self._path.piece) != len(piece):
            self._path = self._path.gone_on(self.chain.poses, SYSTEMATIC * self.chain.covariance, piece)
        return self._path

    def due(self, frame: Frame) -> tuple[int, list[tuple[int, Arrays]]]:
        """Takes the next frame: its number, and the frames that are keyframes now, it or the one before, looked at.

        Raises:
          ValueError: it is not later than the one before, is of another size than the camera's images, or has odometry
            where the ones before had none or the other way round.
        """
        number = self._checked(frame)
        due: list[tuple[int, Arrays]] = []
        if self.follower is not None:
            if frame.rgb is None:
                self.broken.append(number)
            else:
                kept = self._ahead.take("seen", number, frame, self._seen)
                numbers = self.follower.add(number, frame.stamp_s, kept)
                due = [(one, self.follower.kept(one)) for one in numbers]
        elif self._moved(frame.odom_from_base):
            if frame.rgb is None:
                self.broken.append(number)
            else:
                due = [(number, self._ahead.take("seen", number, frame, self._seen))]
        if frame.rgb is not None:
            self._images[number] = frame
        self._ahead.forget(number - 1)
        return number, due

    def expect(self, number: int, frame: Frame) -> None:
        """Begins to look at a frame that will be added under that number; what comes out is the same without."""
        if frame.rgb is not None:
            self._ahead.begin("seen", number, frame, self._seen)
            if self._corners:
                # The floor told nothing of the last step: a turn, and it is not over.
                self._ahead.begin("corners", number, frame, self._find_corners)

    def passed(self, frame: Frame, number: int, keyframe: bool) -> None:
        """Lets go of images that no step needs any more, and notes where a frame is that is no keyframe."""
        for old in [n for n in self._images if n < number - 1 and n != self._last_keyframe()]:
            del self._images[old]
        if not keyframe and len(self.keyframes) > self.start:
            self._between.append(Between(number, frame.stamp_s, frame.name, self._from_keyframe()))

    def _checked(self, frame: Frame) -> int:
        before = (float(self.frames.stamp_s[-1]), not np.isnan(self.frames.odom[-1, 0])) if len(self.frames) else None
        check_frame(frame, len(self.frames), self.camera, self.config.motion, before)
        if before is None and self.follower is None and (frame.odom_from_base is None or self.config.motion == "floor"):
            self._follow()
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

    def _seen(self, number: int, frame: Frame) -> Arrays:
        assert frame.rgb is not None
        level = used(self.lean)
        described = self.eyes.describe(frame.rgb, frame.depth_m, None if level is None else level[number])
        described = jax.tree.map(np.asarray, described)
        return packed(described) | packed_place(self.place(described.place))

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

    def _way(self, first: int) -> Float[np.ndarray, "N 3"]:
        """Where keyframes from one on are thought to be before anything is fused: wheels, or the floor followed."""
        if self.follower is None:
            return self.keyframes.odom[first:]
        return np.array([self.follower.pose_of(int(number)) for number in self.keyframes.frame[first:]])

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
            if (steps.used & (steps.j == row - 1)).any():
                self._corners = {}
            else:
                steps = joined([steps, self._bridge(row, stamp_s, counted)])
        self._steps = steps
        self.chain.go_on(stamp_s, steps, counted)

    def _bridge(self, row: int, stamp_s: float, wheels: Float[np.ndarray, "2 3"] | None) -> Steps:
        numbers = self.keyframes.frame[[row, row - 1]].tolist()
        later, earlier = (self._corners_of(number) for number in numbers)
        self._corners = {} if later is None else {numbers[0]: later}
        if later is None or earlier is None:
            return no_steps()
        return step_of(
            row, row - 1, later, earlier, self.camera, wheels, self.chain.expected(stamp_s), self.config.odometry
        )

    def _corners_of(self, number: int) -> ImageFeatures | None:
        """Of the whole image of a keyframe; None where it is not at hand."""
        if number in self._corners:
            return self._corners[number]
        frame = self._images.get(number)
        if frame is None:
            images = None if self.recording is None else self.recording.load(number)
            if images is None:
                return None
            frame = Frame(0.0, *images)
        return self._ahead.take("corners", number, frame, self._find_corners)

    def _find_corners(self, number: int, frame: Frame) -> ImageFeatures:
        assert frame.rgb is not None
        level = image_level(self.lean)
        seen = None if self.recording is None or self.recording.ignored is None else ~self.recording.ignored
        leant = None if level is None else level[number]
        side = QUICK_SIDE if self.follower is None else LONGEST_SIDE
        return image_corners(frame.rgb, frame.depth_m, self.camera, seen, leant, longest_side=side)

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

    def way_everywhere(self) -> Float[np.ndarray, "F 3"]:
        """Wheels, or the floor followed, at all frames."""
        return self.frames.odom if self.follower is None else self.follower.everywhere(len(self.frames))

    def bridged_steps(self) -> Steps:
        """Steps that whole images measured."""
        return joined(self.bridged) if self.bridged else no_steps()

    def _from_keyframe(self) -> Float[np.ndarray, "3"]:
        """The last frame, from the last keyframe, by wheels or the floor followed."""
        if self.follower is None:
            return between(self.keyframes.odom[-1], self.frames.odom[-1])
        return between(self.follower.pose_of(self._last_keyframe()), self.follower.poses[-1])


def default_view(camera: Camera) -> RunView:
    """The floor that a camera sees well, 1 cm a pixel."""
    return from_camera(camera, choose_floor(camera, METRES_PER_PX))
