"""The calibrations of a run in an RTAB-Map database: the most frequent one, and whether the camera moves."""

import sqlite3
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ebjax.io.logs.rtabmap_calibration import DatabaseCamera, cameras_from_blob
from ebjax.io.logs.rtabmap_database import columns
from ebjax.io.logs.rtabmap_nodes import Node

SAME_M, SAME_RAD, SAME_PX = 1e-3, 1e-3, 0.1
MOST_CALIBRATIONS = 500


def read_calibrations(
    database: sqlite3.Connection, path: Path, nodes: Sequence[Node], version: tuple[int, ...]
) -> list[tuple[tuple[DatabaseCamera, ...], int]]:
    """The calibrations of at most 500 nodes spread over the run, each with its number of nodes, most frequent first.

    A calibration stands behind the images in its row, so that reading every one would read the whole file.

    Raises:
      ValueError: a damaged calibration; names the file.
    """
    if "calibration" not in columns(database, "Data"):
        return []
    rows = np.unique(np.linspace(0, len(nodes) - 1, min(len(nodes), MOST_CALIBRATIONS)).astype(int)).tolist()
    query = "SELECT CAST(calibration AS BLOB) FROM Data WHERE id = ?"
    blobs = Counter(blob for row in rows for (blob,) in database.execute(query, (nodes[row].id,)) if blob)
    found = []
    for blob, count in blobs.most_common():
        try:
            found.append((cameras_from_blob(blob, version), count))
        except ValueError as error:
            raise ValueError(f"{path}: {error}; give a database that is not damaged") from None
    return found


def shift_and_turn(a: Float[np.ndarray, "4 4"], b: Float[np.ndarray, "4 4"]) -> tuple[float, float]:
    """How far two mounts lie apart, m and rad."""
    b_in_a = np.linalg.inv(a) @ b
    skew = b_in_a[:3, :3] - b_in_a[:3, :3].T
    sine, cosine = np.linalg.norm(skew[[2, 0, 1], [1, 2, 0]]), np.trace(b_in_a[:3, :3]) - 1
    return float(np.linalg.norm(b_in_a[:3, 3])), float(np.arctan2(sine, cosine))


def _same_intrinsics(a: DatabaseCamera, b: DatabaseCamera) -> bool:
    if a.rectified is None or b.rectified is None:
        return a.rectified is b.rectified
    near = np.allclose(a.rectified, b.rectified, rtol=0, atol=SAME_PX, equal_nan=True)
    return near and (a.width, a.height) == (b.width, b.height)


def movement_notes(
    path: Path, camera: DatabaseCamera, others: Sequence[tuple[DatabaseCamera, int]], total: int
) -> list[str]:
    """Notes where the mount or the intrinsics of other nodes differ from the camera that is used.

    Args:
      path: of the database.
      camera: that is used.
      others: of other nodes, each with the number of nodes.
      total: number of nodes that were looked at.
    """
    moved, shift_m, turn_rad, changed = 0, 0.0, 0.0, 0
    for other, count in others:
        changed += 0 if _same_intrinsics(camera, other) else count
        if camera.base_from_camera is None or other.base_from_camera is None:
            moved += 0 if camera.base_from_camera is other.base_from_camera else count
            continue
        metres, radians = shift_and_turn(camera.base_from_camera, other.base_from_camera)
        shift_m, turn_rad = max(shift_m, metres), max(turn_rad, radians)
        moved += count if metres > SAME_M or radians > SAME_RAD else 0
    notes = []
    if moved:
        notes.append(
            f"{path}: the camera moves on the robot: at {moved} of {total} nodes its mount differs from the one that "
            f"is used, by up to {shift_m:.3f} m and {np.rad2deg(turn_rad):.1f} degrees"
        )
    if changed:
        notes.append(f"{path}: at {changed} of {total} nodes the intrinsics differ from those that are used")
    return notes
