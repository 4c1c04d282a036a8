"""The engine as a robot drives it: frames in, updates out, kept in a map where there is one."""

import contextlib
import dataclasses
import time
import weakref
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ebjax.front.close import remembering
from ebjax.front.log import Log
from ebjax.front.run import Driven, Run
from ebjax.front.taken import taken
from ebjax.geometry.camera import Camera
from ebjax.geometry.planar import between, compose, inverse
from ebjax.io.images import BrokenFrame
from ebjax.io.logs.log import Images
from ebjax.io.logs.log import Log as Recorded
from ebjax.io.sequence import Sequence
from ebjax.mapping.kept_run import read_as
from ebjax.mapping.looked_by import camera_file
from ebjax.mapping.seen_floor import run_view
from ebjax.mapping.store import MapStore, open_map
from ebjax.slam.drive import drive
from ebjax.slam.engine import Engine
from ebjax.slam.frame import Frame, Update
from ebjax.slam.lean import Lean
from ebjax.slam.mapper import Mapper as InMemory
from ebjax.slam.pipeline import leaning
from ebjax.slam.run import Run as Thought
from ebjax.slam.store import Between
from ebjax.slam.world import matrices


class Mapper:
    """Closes loops from opposing views as the robot drives.

        mapper = Mapper(camera, map="building.ebmap")
        for frame in open_log("run.bag"):
            update = mapper.add(frame)      # where the robot is, which closures are new
        run = mapper.finish()

    JAX is set as the commands set it: to float64, and with compiled programs kept for the next time.

    Attributes:
      options: of the engine.
      notes: what a map says when it is opened, at the first frame, a line each.
    """

    def __init__(self, camera: Camera | Log, *, map: str | Path | None = None, name: str = "robot", **options: Any):
        """Begins a run.

        Args:
          camera: of the images, as it is mounted. Or a log from `open_log`, whose frames are then added one by one: its
            camera is taken, its floor and pixels that are no floor, and at the end its images can be asked again, so
            that what comes out are the bits of `close_loops`.
          map: NAME.ebmap, where keyframes are kept as they come, and which the run recognises; None: in memory.
          name: what the run is called in the map; a log's own. One of the same name and first time that was stopped
            goes on: give its frames from the first on; those that the map has are not looked at again.
          options: of the engine, as of `close_loops`, and of a camera alone: view, quad, quad_margin, metres_per_px.

        Raises:
          ValueError: an unknown option, or one of how a log is read; an unknown descriptor or extractor; the camera
            sees no floor.
        """
        self.options, self._camera, log = taken(camera, options, "Mapper")
        self._view = log.view if log else partial(run_view, self.options, None)
        self._recording = log.recording if log else None
        self._path = None if map is None else Path(map)
        self._name = str(log.sequence.path.resolve()) if log else name
        self._log, self._at_end = log, contextlib.ExitStack()
        self._remember = remembering(self.options, self._at_end)
        self._store: MapStore | None = None
        self._stood: dict[int, np.ndarray] = {}
        self._begun_s = time.perf_counter()
        self._lean: Lean | None = None
        self._engine = self._made(self._camera, None)
        if log and (lean := leaning(log.recording, self._engine)) is not None:
            self._lean, self._engine = lean, self._made(self._camera, lean)
        self.notes: tuple[str, ...] = ()

    def add(self, frame: Frame) -> Update:
        """Takes the next frame; says where the robot is, and which closures are new, believed since, or taken back.

        Raises:
          ValueError: it is not later than the one before, of another size than the camera's images, or has odometry
            where those before had none or the other way round; the map was made with something else.
          OSError: the keyframe cannot be kept.
        """
        if self._path is not None and not len(self._engine.frames) and self._store is None:
            self._open(self._path, frame)
        engine = self._engine
        if len(engine.frames) >= engine.next_frame:
            return engine.add(frame)
        return self._known(engine, frame)

    def finish(self) -> Run:
        """Thinks the whole run over; where there is a map, it holds the run as finished.

        Raises:
          ValueError: fewer than two frames could be read.
          OSError: the map cannot be written.
        """
        if self._log and len(self._engine.frames) < len(self._log):  # its later frames are no part of the run
            self._engine.recording = None
        thought = self._engine.finish(self._again)
        sequence = self._sequence(thought)
        load, broken = (self._log.images.both, self._log.images.broken) if self._log else (_forgotten, {})
        took_s = time.perf_counter() - self._begun_s
        run = Run.of(thought, Driven(sequence, load, broken, self.options, self.notes, took_s))
        store, self._store = self._store, None
        if store is not None:
            store.finished(thought, _rest(thought, sequence))
            store.read_on()
            weakref.finalize(run, store.close)
        self._at_end.close()
        return run

    def close(self) -> None:
        """Leaves the run as it is; a map holds it unfinished, and the same run goes on there."""
        if self._store is not None:
            self._store.close()
            self._store = None
        self._at_end.close()

    def __enter__(self) -> "Mapper":
        return self

    def __exit__(self, *stop: object) -> None:
        self.close()

    def _made(self, camera: Camera, lean: Lean | None) -> InMemory:
        ways: dict[str, Any] = {"view": self._view, "recording": self._recording, "remember": self._remember}
        return InMemory(camera, self.options, lean=lean, store=self._store, **ways)

    def _open(self, path: Path, first: Frame) -> None:
        """Opens the map for a run that begins with this frame."""
        view = self._engine.view_of(self._camera)
        run: dict[str, Any] = {"camera": self._camera, "view": view, "config": self.options, "lean": self._lean}
        facts = read_as(self._log.options) if self._log else None
        self._store = open_map(path, log=self._name, facts=facts, first_stamp_s=first.stamp_s, **run)
        self.notes = self._store.notes
        self._engine = self._made(self._camera, self._lean)
        placed = self._store.file.frames(self._store.current)
        self._stood = dict(zip(placed.frame.tolist(), placed.keyframe_from_base, strict=True))

    def _known(self, engine: InMemory, frame: Frame) -> Update:
        """What the map knows of a frame that it has already; its covariance is left out, zero."""
        begun_s = time.perf_counter()
        engine.pass_by(frame)
        number = len(engine.frames) - 1
        row = int(engine.frames.row[number])
        before = engine.start + int(np.searchsorted(engine.numbers, number, side="right")) - 1
        pose = compose(engine.chain.poses[before], self._stood.get(number, np.zeros(3)))
        odom = frame.odom_from_base
        return Update(
            number,
            frame.stamp_s,
            None if row < 0 else row,
            pose,
            not engine.start,
            None if odom is None else compose(pose, inverse(np.asarray(odom, float))),
            np.zeros((3, 3)),
            milliseconds=1e3 * (time.perf_counter() - begun_s),
        )

    def _again(self, engine: Engine, camera: Camera, lean: Lean | None) -> Engine:
        """Drives the recording once more, as that camera sees it."""
        assert self._recording is not None
        if self._store is not None:
            self._store = self._store.again(camera, engine.view_of(camera), lean)
        another = self._made(camera, lean)
        drive(another, self._recording)
        return another

    def _sequence(self, thought: Thought) -> Sequence:
        """The log's, or the frames that were added, whose images are gone."""
        if self._log is not None:
            return first_frames(self._log.sequence, len(thought.poses))
        frames, names = self._engine.frames, tuple(self._engine.names)
        wheels = bool(np.isfinite(frames.odom).all())
        stamps = frames.stamp_s.copy()
        images = Images("the frames", names, stamps, _decode)
        log = Recorded(Path(self._name), "frames of a robot", images)
        odom = matrices(frames.odom) if wheels else None
        return Sequence(log, np.arange(len(names)), stamps, odom, None, camera_file(thought.camera))


def first_frames(sequence: Sequence, count: int) -> Sequence:
    """A sequence up to a frame."""
    columns = ("rows", "timestamps", "odom_from_base", "world_from_base", "depth_rows")
    values = ((name, getattr(sequence, name)) for name in columns)
    cut: dict[str, Any] = {name: None if value is None else value[:count] for name, value in values}
    return dataclasses.replace(sequence, **cut)


def _forgotten(frame: int) -> None:
    """The images of frames that a robot gave are gone."""


def _decode(row: int) -> np.ndarray:
    raise BrokenFrame(f"frame {row}: its image was given to a mapper and is not kept")


def _rest(run: Thought, sequence: Sequence) -> list[Between]:
    """The frames since the last keyframe."""
    last, times, names = int(run.keyframes[-1]), sequence.timestamps, sequence.names
    return [
        Between(k, float(times[k]), names[k], between(run.poses[last], run.poses[k]))
        for k in range(last + 1, len(run.poses))
    ]
