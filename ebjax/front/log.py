"""A recorded run, opened: its frames one by one, and the camera that took them over the floor that it sees."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ebjax.command import setup_jax
from ebjax.front.options import Options, options_from
from ebjax.geometry.camera import Camera
from ebjax.io.frames import Frames
from ebjax.io.sequence import Sequence
from ebjax.mapping.open_run import camera_source, open_run, recording_of
from ebjax.mapping.seen_floor import camera_over_floor, ignored_pixels, view_chooser
from ebjax.slam.drive import decoded_ahead
from ebjax.slam.frame import Frame
from ebjax.slam.recording import Recording
from ebjax.slam.world import planar
from ebjax.views.run_view import RunView


def open_log(log: str | Path, **options: Any) -> "Log":
    """Opens a robot's log of any kind: TUM folder, ROS bag, RTAB-Map database, video, folder of images.

        for frame in open_log("run.bag", topics={"odometry": "/wheels/odom"}):
            update = mapper.add(frame)

    Args:
      log: file or folder.
      options: how it is read, as `python -m ebjax.slam --help` lists them: camera, mount, topics, depth, view and so
        on. `reader="my_package.mine:NAME"`, or a function, reads a kind of log that ebjax does not know.

    Raises:
      ValueError: nothing there that is read, a fault in it, an unknown option; names file or option, and the remedy.
      OSError: it cannot be read.
    """
    given = {**options, "sequence": log}
    return Log(options_from(given, Options, "open_log"), given)


class Log:
    """A recorded run. Iterating decodes its images, two frames at a time; nothing else is kept in memory.

    Attributes:
      options: how it is read.
      given: those of them that were given.
      sequence: frames, poses at their times, and camera.
      images: of the frames, and which of them cannot be read.
      notes: how it was read, a line each.
    """

    def __init__(self, options: Options, given: dict[str, Any] | None = None):
        self.options, self.given = options, given or {}
        self.sequence: Sequence = open_run(options, odometry=options.motion != "floor")
        self.images = Frames(self.sequence)
        self.notes: tuple[str, ...] = self.sequence.notes

    def __repr__(self) -> str:
        odometry = "odometry" if self.sequence.odom_from_base is not None else "no odometry"
        depth = "depth" if self.sequence.has_depth else "no depth"
        return f"Log({self.sequence.path}, {self.sequence.log.kind}: {len(self)} frames, {odometry}, {depth})"

    def __len__(self) -> int:
        """Returns the number of frames."""
        return len(self.sequence)

    def __iter__(self) -> Iterator[Frame]:
        """The frames in the order of their times; `rgb` is None where an image cannot be read."""
        recording = recording_of(self.sequence, self.images)
        odometry = recording.odom_from_base
        with ThreadPoolExecutor(2) as pool:
            images = decoded_ahead(pool, recording.load, list(range(len(self))))
            for k, both in enumerate(images):
                rgb, depth_m = both or (None, None)
                odom = None if odometry is None else odometry[k]
                yield Frame(float(recording.timestamps[k]), rgb, depth_m, odom, recording.names[k])

    @property
    def truth(self) -> Float[np.ndarray, "F 3"] | None:
        """True x, y (m) and heading (rad) of every frame, NaN where it is not known; None of a log without."""
        truth = self.sequence.world_from_base
        return None if truth is None else planar(truth)

    @cached_property
    def _over_floor(self) -> tuple[Camera, tuple[str, ...]]:
        setup_jax()
        return camera_over_floor(self.options, self.sequence)

    @cached_property
    def _ignored(self) -> tuple[Bool[np.ndarray, "H W"] | None, tuple[str, ...]]:
        return ignored_pixels(self.options.mask, self.sequence)

    @property
    def camera(self) -> Camera:
        """As it is mounted over the floor."""
        return self._over_floor[0]

    @cached_property
    def view(self) -> Callable[[Camera], RunView]:
        """What chooses the floor that a camera looks at, without pixels that are no floor."""
        return view_chooser(self.options, self._ignored[0], self.camera, camera_source(self.options, self.sequence))

    @cached_property
    def recording(self) -> Recording:
        """As the engine takes it."""
        timed = self.options.time_offset_s == "auto"
        return recording_of(self.sequence, self.images, self._ignored[0], timed=timed)

    @property
    def remarks(self) -> tuple[str, ...]:
        """How the camera was laid over the floor and which pixels are left out, a line each."""
        return (*self._over_floor[1], *self._ignored[1])
