"""Loop closures into a copy of an RTAB-Map database, as user links (type 4): what its database viewer does on saving.

RTAB-Map optimises anew with them when it next opens the copy. `rtabmap-reprocess` keeps them with -pub_loops.
"""

import contextlib
import errno
import os
import sqlite3
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ebjax.io.logs.rtabmap_closure import Closure, information_from_closure, transforms_from_closure
from ebjax.io.logs.rtabmap_database import check_version, columns, is_open_elsewhere, reading
from ebjax.io.logs.rtabmap_nodes import INVALID
from ebjax.io.one_line import one_line

__all__ = ["Closure", "Written", "write_closures"]

OLDEST_WRITTEN = (0, 13, 0)
USER_CLOSURE = 4
ODOMETRY_LINKS = (0, 6)
INFORMATION_BYTES = 288
INSERT = "INSERT INTO Link(type, information_matrix, transform, user_data, from_id, to_id) VALUES(?, ?, ?, NULL, ?, ?)"
CLEARED = {
    "opt_ids": None,
    "opt_poses": None,
    "opt_map": None,
    "opt_map_x_min": 0,
    "opt_map_y_min": 0,
    "opt_map_resolution": 0,
    "opt_cloud": None,
    "opt_polygons_size": None,
    "opt_polygons": None,
    "opt_tex_coords": None,
    "opt_tex_materials": None,
}


@dataclass(frozen=True)
class Written:
    """How many closures became links, how many were skipped because their nodes are linked already or not valid."""

    inserted: int
    linked: int
    invalid: int

    def summary(self) -> str:
        """The counts in one line."""
        return f"{self.inserted} closures inserted, {self.linked} already linked, {self.invalid} with an invalid node"


def odometry_information(database: sqlite3.Connection, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The typical (median) and the greatest information of odometry's links: x y z roll pitch yaw, 1/m^2 and 1/rad^2.

    Raises:
      ValueError: no odometry link has valid information.
    """
    rows = database.execute(f"SELECT information_matrix FROM Link WHERE type IN {ODOMETRY_LINKS}")
    blobs = [blob for (blob,) in rows if isinstance(blob, bytes) and len(blob) == INFORMATION_BYTES]
    diagonals = np.array([np.frombuffer(blob, "<f8").reshape(6, 6).diagonal() for blob in blobs]).reshape(-1, 6)
    diagonals = diagonals[np.all(np.isfinite(diagonals) & (diagonals > 0), axis=1)]
    if not len(diagonals):
        raise ValueError(f"{path}: no odometry link with information; RTAB-Map cannot weigh a closure against it")
    return np.median(diagonals, axis=0), diagonals.max(axis=0)


def _insert(
    database: sqlite3.Connection, closures: Sequence[Closure], information: Sequence[Float[np.ndarray, "6 6"]]
) -> Written:
    nodes = {node for (node,) in database.execute(f"SELECT id FROM Node WHERE COALESCE(weight, 0) > {INVALID}")}
    links = {frozenset(pair) for pair in database.execute("SELECT from_id, to_id FROM Link")}
    inserted = linked = invalid = 0
    for closure, weight in zip(closures, information, strict=True):
        ends, pair = (closure.from_node, closure.to_node), frozenset((closure.from_node, closure.to_node))
        if not nodes >= pair or len(pair) == 1:
            invalid += 1
        elif pair in links:
            linked += 1
        else:
            for (start, end), transform in zip((ends, ends[::-1]), transforms_from_closure(closure), strict=True):
                values = (USER_CLOSURE, weight.astype("<f8").tobytes(), transform, start, end)
                database.execute(INSERT, values)
            links.add(pair)
            inserted += 1
    present = [column for column in CLEARED if column in columns(database, "Admin")]
    if inserted and present:
        settings = ", ".join(f"{column} = ?" for column in present)
        database.execute(f"UPDATE Admin SET {settings}", [CLEARED[column] for column in present])
    return Written(inserted, linked, invalid)


def write_closures(source: str | Path, out: str | Path, closures: Sequence[Closure]) -> Written:
    """Writes a copy of an RTAB-Map database with closures as user links; `source` is not changed.

    A closure is skipped where a link of any type joins its nodes already (RTAB-Map refuses a database with two), or
    where a node is missing or left out by RTAB-Map. The copy appears whole or not at all; an old `out` is replaced.

    Args:
      source: the database; RTAB-Map must not have it open.
      out: the copy; another file.
      closures: in the order in which they count where two join the same nodes.

    Raises:
      ValueError: as `open_rtabmap`; a version before 0.13.0, `out` is `source`, or a closure that is no measurement.
      OSError: the folder cannot be written.
    """
    source, out = Path(source), Path(out)
    if out.is_dir():
        raise ValueError(f"{out}: is a folder; name a file for the copy")
    if out.exists() and source.exists() and os.path.samefile(source, out):
        raise ValueError(f"{out}: is the database itself; name another file for the copy")
    if is_open_elsewhere(out):
        raise ValueError(f"{out}: another program has it open; close RTAB-Map or name another file")
    with reading(source) as database, contextlib.ExitStack() as stack:
        version = check_version(database, source)
        if version < OLDEST_WRITTEN or "information_matrix" not in columns(database, "Link"):
            words = ".".join(map(str, version))
            raise ValueError(
                f"{source}: of RTAB-Map {words}; closures are written from 0.13.0 on, make it anew with "
                "rtabmap-reprocess of a newer version"
            )
        typical, most = odometry_information(database, source)
        information = [information_from_closure(closure, typical, most) for closure in closures]
        out.parent.mkdir(parents=True, exist_ok=True)
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent))
        copy = Path(folder) / out.name
        try:
            with contextlib.closing(sqlite3.connect(copy)) as target:
                database.backup(target)
                with target:
                    written = _insert(target, closures, information)
        except sqlite3.OperationalError as error:
            if "full" not in str(error) and "I/O" not in str(error):
                raise
            raise OSError(errno.EIO, f"the copy cannot be written ({one_line(error)}); make room", str(out)) from None
        os.replace(copy, out)
    return written
