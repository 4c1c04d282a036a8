"""Where a robot is in a map that was kept, frame by frame."""

import contextlib
import math
from pathlib import Path
from typing import Any

from ebjax.front.close import remembering
from ebjax.front.log import Log
from ebjax.front.taken import taken
from ebjax.geometry.camera import Camera
from ebjax.mapping.agreement import check_map, made_with
from ebjax.mapping.seen_floor import run_view
from ebjax.mapping.still_map import open_still_map
from ebjax.slam.frame import Frame
from ebjax.slam.localise import Localiser as InMap
from ebjax.slam.localise import Whereabouts


class Localiser:
    """Says where a robot is in a map; no byte of the map's file changes.

        with Localiser(camera, map="building.ebmap") as localiser:
            for frame in robot:
                where = localiser.add(frame)    # where.state: "lost" or "found"; where.map_from_base

    Attributes:
      options: of the engine.
      notes: what the map says when it is opened, a line each.
    """

    def __init__(
        self,
        camera: Camera | Log,
        *,
        map: str | Path,
        start: tuple[float, float, float] | None = None,
        **options: Any,
    ):
        """Opens a map to be localised in.

        Args:
          camera: of the images, as it is mounted, or a log from `open_log` whose frames are then added.
          map: NAME.ebmap, which holds a finished run.
          start: about where the robot starts: x, y (m), heading (degrees); None: it is lost until a place is
            recognised.
          options: of the engine, as of `Mapper`.

        Raises:
          ValueError, OSError: as of `Mapper`; there is no such map, it cannot be read, holds no finished run, or was
            made with something else.
        """
        self.options, own, log = taken(camera, options, "Localiser")
        view = (log.view if log else lambda mounted: run_view(self.options, None, mounted))(own)
        self._at_end = contextlib.ExitStack()
        try:
            still = self._at_end.enter_context(open_still_map(map))
            self.notes = (
                *still.notes,
                *check_map(still.file.path, still.file.facts, made_with(self.options, own, view)),
            )
            self._localiser = InMap(
                still.camera,
                self.options,
                still,
                still.poses,
                view=still.view,
                recording=log.recording if log else None,
                remember=remembering(self.options, self._at_end),
                start=None if start is None else (start[0], start[1], math.radians(start[2])),
            )
        except BaseException:
            self.close()
            raise

    def add(self, frame: Frame) -> Whereabouts:
        """Takes the next frame; says where the robot is.

        Raises:
          ValueError: as of `Mapper.add`.
        """
        return self._localiser.add(frame)

    def close(self) -> None:
        """Lets go of the map."""
        self._at_end.close()

    def __enter__(self) -> "Localiser":
        return self

    def __exit__(self, *stop: object) -> None:
        self.close()
