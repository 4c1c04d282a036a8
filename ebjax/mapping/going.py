"""The run that goes into a map, and the sessions that are begun and removed for it."""

import dataclasses
import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from ebjax.geometry.camera import Camera
from ebjax.io.map_file.file import MapFile
from ebjax.io.map_file.rows import SessionRow
from ebjax.mapping.agreement import made_with, settings_of
from ebjax.mapping.looked_by import NAME, looked_by_arrays
from ebjax.mapping.sessions import facts_of, left_over, of_run
from ebjax.slam.config import PipelineConfig
from ebjax.slam.lean import Lean
from ebjax.views.run_view import RunView


@dataclasses.dataclass(frozen=True)
class Going:
    """A run that goes into a map.

    Attributes:
      log: its name.
      first_stamp_s: time of its first frame; name and time say which run it is.
      config: of the engine.
      facts: what else must agree to go on with it, as JSON holds it.
    """

    log: str
    first_stamp_s: float
    config: PipelineConfig
    facts: Mapping[str, Any]

    def agrees(self, camera: Camera, view: RunView, lean: Lean | None) -> dict[str, Any]:
        """All that must agree to go on with a drive of it."""
        return {
            **made_with(self.config, camera, view),
            **settings_of(self.config),
            "pixels that are looked at": _digest(view.seen),
            "lean of the robot": "none" if lean is None else f"{lean.by} {lean.used} {_digest(lean.level_from_base)}",
            **self.facts,
        }

    def sessions(self, file: MapFile) -> list[SessionRow]:
        """Those of the run that a map holds."""
        return of_run(file.sessions(), self.log, self.first_stamp_s)

    def begin(self, file: MapFile, agrees: dict[str, Any], *, again: bool) -> SessionRow:
        """Begins a session for it."""
        number = file.begin_session(self.log, facts_of(self.log, self.first_stamp_s, agrees, again=again))
        return next(one for one in file.sessions() if one.id == number)

    def forget_left_over(self, file: MapFile) -> None:
        """Removes drives of it that a finished one has replaced."""
        for number in left_over(self.sessions(file)):
            file.forget(number)


def tell_camera(file: MapFile, session: SessionRow, camera: Camera, view: RunView) -> None:
    """Writes what a session is looked at with, once."""
    if NAME not in session.state:
        file.put_state(session.id, NAME, looked_by_arrays(camera, view))


def _digest(values: Any) -> str:
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()[:16]
