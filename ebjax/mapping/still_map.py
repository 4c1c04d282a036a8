"""A map's file as a run is localised in it: read, never written.

with open_still_map("building.ebmap") as still:
    localiser = Localiser(still.camera, config, still, still.poses, view=still.view)

Sessions that are not finished, or that no closure joins to the first, are left out, and a note says so.
"""

from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ebjax.geometry.camera import Camera, camera_from, image_from_floor
from ebjax.io.map_file.file import MapFile
from ebjax.mapping.contents import CLOSURE, Contents, open_map_to_read, plural, read_contents
from ebjax.mapping.looked_by import LookedBy
from ebjax.posegraph.graph import components
from ebjax.slam.packed import Arrays
from ebjax.slam.store import Between
from ebjax.views.run_view import RunView


class StillMap:
    """The keyframes of the finished sessions of a map, as the localiser reads them.

    Attributes:
      file: of the map.
      poses: as last solved: x, y (m), heading (rad); NaN for sessions that no closure joins to the first.
      camera: that the newest session was looked at with, its mount as the run settled it.
      view: its floor view.
      notes: what a user should know, a line each.
      current: the session that is added to: none.
    """

    current = 0

    def __init__(self, file: MapFile):
        """As `open_still_map` does."""
        self.file = file
        contents = read_contents(file)
        finished = [one.id for one in contents.sessions if one.finished]
        rows = np.flatnonzero(np.isin(contents.keyframes.session, finished))
        if not len(rows):
            raise ValueError(
                f"{file.path}: holds no finished run to be localised in; finish one first: "
                f"python -m ebjax.slam LOG --map {file.path}"
            )
        self._ids, self._pieces = contents.keyframes.id[rows].tolist(), contents.keyframes.session[rows].tolist()
        joined = joined_to_first(contents, finished)
        known = np.isin(self._pieces, joined)
        self.poses = np.where(known[:, None], contents.keyframes.pose[rows], np.nan)
        self.camera, self.view = camera_and_view(contents.looked[joined[-1]])
        self.notes = (*file.notes, *_left_out(file.path, contents, finished, joined))

    def __enter__(self) -> "StillMap":
        return self

    def __exit__(self, *stop: object) -> None:
        self.file.close()

    def __len__(self) -> int:
        """Returns the number of keyframes."""
        return len(self._ids)

    def piece(self, row: int) -> int:
        """The session that a keyframe belongs to."""
        return self._pieces[row]

    def settled_step(self, row: int, kept: Arrays) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """Of a keyframe: where it is now, and the covariance of the step to it as it came."""
        return self.poses[row], kept["at.step"]

    def arrays(self, row: int) -> Arrays:
        """Those of a keyframe.

        Raises:
          Damaged: they are not what was written; names the keyframe.
        """
        return self.file.arrays(self._ids[row])

    def keep(self, kept: Arrays, name: str = "", between: Sequence[Between] = ()) -> None:
        """Nothing is added.

        Raises:
          ValueError: always.
        """
        raise ValueError(f"{self.file.path}: stands still while a run is localised in it")


def open_still_map(path: str | Path) -> StillMap:
    """Opens a map to localise in; no byte of its file is changed, and a run may be written into it meanwhile.

    Raises:
      ValueError, OSError: no such map, a damaged one, or one without a finished run.
    """
    file = open_map_to_read(Path(path))
    try:
        return StillMap(file)
    except BaseException:
        file.close()
        raise


def joined_to_first(contents: Contents, sessions: Sequence[int]) -> list[int]:
    """Which of some sessions are in the frame of the first of them: closures that are kept join them to it."""
    kept = contents.of_kind(CLOSURE) & contents.edges.kept
    ends = contents.keyframes.session[contents.ends(kept)]
    ends = np.searchsorted(sessions, ends[np.isin(ends, sessions).all(1)])
    label = components(len(sessions), ends[:, 0], ends[:, 1])
    return [one for one, mine in zip(sessions, label == label[0], strict=True) if mine]


def camera_and_view(looked: LookedBy) -> tuple[Camera, RunView]:
    """As the engine takes them."""
    camera = camera_from(looked.camera)
    image_from_view = np.asarray(image_from_floor(camera), np.float64) @ looked.floor_from_view
    dtype = jnp.asarray(camera.intrinsics).dtype
    parts = jnp.asarray(image_from_view, dtype), jnp.asarray(looked.floor_from_view, dtype), jnp.asarray(looked.seen)
    return camera, RunView(*parts)


def _left_out(path: Path, contents: Contents, finished: list[int], joined: list[int]) -> list[str]:
    notes = []
    for one in contents.sessions:
        count = plural(len(contents.rows(one.id)), "keyframe")
        if one.id not in finished:
            notes.append(f"{path}: session {one.id} is not finished; its {count} are not looked for")
        elif one.id not in joined:
            notes.append(
                f"{path}: no closure joins session {one.id} to session {joined[0]}; its {count} are not looked for"
            )
    return notes
