"""The keyframes of an open map as the engine knows them, by row, and the session that is added to.

Rows are in the order of the keyframes' ids. Of other sessions those are known that `sessions.known` says.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ebjax.io.map_file.file import MapFile
from ebjax.io.map_file.rows import EdgeRow, FrameRow, KeyframeRow, SessionRow
from ebjax.mapping.contents import CLOSURE, PATH, POSES
from ebjax.mapping.numbering import with_ids, with_rows
from ebjax.mapping.sessions import known
from ebjax.mapping.walk import packed_walk, unpacked_walk
from ebjax.slam.believe import KEPT
from ebjax.slam.packed import Arrays
from ebjax.slam.path import SYSTEMATIC
from ebjax.slam.path import Path as Walk
from ebjax.slam.run import Earlier
from ebjax.slam.table import Table

MEASURED = "measured"
"""Of the state POSES: whether the floor measured the path; else wheels alone say it."""


class MapShelf:
    """Keyframes by row.

    Attributes:
      file: of the map.
      current: number of the session.
    """

    def __init__(self, file: MapFile, session: SessionRow):
        """Takes the map as it is; `session` is added to."""
        self.file, self.current = file, session.id
        self._walks: dict[int, Walk | None] = {}
        keyframes, self._rows = file.keyframes(), Table(id=int, session=int)
        for k in np.flatnonzero(np.isin(keyframes.session, list(known(file.sessions(), session)))).tolist():
            self._rows.append(id=keyframes.id[k], session=keyframes.session[k])

    def __len__(self) -> int:
        """Returns the number of keyframes."""
        return len(self._rows)

    def piece(self, row: int) -> int:
        """The session that a keyframe belongs to."""
        return int(self._rows.session[row])

    def settled_step(self, row: int, kept: Arrays) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """Of a keyframe of an earlier session: its pose on the path, and the covariance of the step to it.

        As its run was thought over at its end; as they came where it never was, or where wheels alone say them.
        """
        session = self.piece(row)
        if session not in self._walks:
            measured = self.file.state(session, POSES).get(MEASURED, False)
            self._walks[session] = self.path(session) if measured else None
        walk, frame = self._walks[session], int(kept["at.frame"])
        if walk is None:
            return kept["at.pose"], kept["at.step"]
        node = int(np.searchsorted(walk.frames, frame))
        return walk.poses[node], walk.covariance[node - 1] / SYSTEMATIC if node else kept["at.step"]

    def arrays(self, row: int) -> Arrays:
        """Those of a keyframe.

        Raises:
          Damaged: they are not what was written; names the keyframe.
        """
        ids = self._rows.id
        kept = self.file.arrays(int(ids[row]))
        # Ids increase from 0: where none is left out they are the rows.
        return kept if ids[-1] == len(ids) - 1 else with_rows(kept, ids)

    def number(self, row: int) -> int:
        """The keyframe's in the file."""
        return int(self._rows.id[row])

    def as_rows(self, kept: Arrays, number: int) -> Arrays:
        """What the file keeps of the next keyframe, which gets this number, as the engine takes it."""
        return with_rows(kept, np.append(self._rows.id, number))

    def numbered(self, kept: Arrays, number: int) -> dict[str, np.ndarray]:
        """What is known of the next keyframe, which gets this number, as `add` takes it."""
        return with_ids(kept, np.append(self._rows.id, number))

    def add(
        self, keyframe: KeyframeRow, arrays: Arrays, edges: Sequence[EdgeRow], frames: Sequence[FrameRow] = ()
    ) -> None:
        """Adds the next keyframe of the session in one transaction.

        Raises:
          OSError: the disk is full or fails; nothing of the keyframe is written.
        """
        self.file.append(keyframe, arrays, [(one, {}) for one in edges], frames)
        self._rows.append(id=keyframe.id, session=self.current)

    def conclude(self, earlier: Earlier, walk: Walk, poses: Float[np.ndarray, "F 3"], *, measured: bool) -> None:
        """Writes what closures made of the map, and ends the session.

        Args:
          earlier: keyframes before the session's, and the candidates of all.
          walk: of the session.
          poses: of its frames.
          measured: whether the floor measured the path.
        """
        file, ids, found = self.file, self._rows.id, earlier.candidates
        edges = file.edges(CLOSURE)
        ends = zip(edges.i.tolist(), edges.j.tolist(), edges.opposing.tolist(), strict=True)
        known_edges = dict(zip(ends, edges.id.tolist(), strict=True))
        ends = zip(ids[found.i].tolist(), ids[found.j].tolist(), found.opposing.tolist(), strict=True)
        # A repair may not have saved every edge.
        said = {known_edges[end]: why for end, why in zip(ends, earlier.reasons, strict=True) if end in known_edges}
        frames = file.keyframes(self.current).frame
        file.settle(
            ids,
            np.concatenate([earlier.poses, poses[frames]]),
            edges=said,
            kept=[reason == KEPT for reason in said.values()],
            reasons=said.values(),
        )
        file.put_state(self.current, PATH, packed_walk(walk))
        file.put_state(self.current, POSES, {POSES: poses, MEASURED: np.array(measured)})
        file.end_session(self.current)

    def path(self, session: int) -> Walk:
        """What the closures of a finished session corrected.

        Raises:
          ValueError: no such session, or it is not finished.
        """
        return unpacked_walk(self._state(session, PATH))

    def poses(self, session: int) -> Float[np.ndarray, "F 3"]:
        """The poses of all frames of a finished session: x, y (m), heading (rad).

        Raises:
          ValueError: as `path`.
        """
        return self._state(session, POSES)[POSES]

    def _state(self, session: int, name: str) -> dict[str, np.ndarray]:
        found = self.file.state(session, name)
        if not found:
            raise ValueError(f"{self.file.path}: holds no finished session {session}")
        return found
