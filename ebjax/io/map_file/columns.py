"""Reads rows of a map into columns, and turns rows into what the tables hold."""

import math
import sqlite3
from collections.abc import Iterable

import numpy as np
from jaxtyping import Float, Int

from ebjax.io.map_file.rows import EdgeRow, Edges, FrameRow, Frames, KeyframeRow, Keyframes
from ebjax.io.map_file.schema import Row, count, get, get_all, put

BLOCK = 256
"""Settled poses a row: a solve changes all of them, ten thousand in some milliseconds."""


def keyframe_values(row: KeyframeRow) -> Row:
    """A keyframe as its table holds it."""
    return (int(row.id), int(row.session), int(row.frame), _real(row.stamp_s), str(row.name), _blob(row.pose))


def frame_values(row: FrameRow) -> Row:
    """A frame as its table holds it, but for the id."""
    return (int(row.frame), _real(row.stamp_s), str(row.name), int(row.keyframe), _blob(row.keyframe_from_base))


def edge_values(row: EdgeRow, has_arrays: bool) -> Row:
    """An edge as its table holds it."""
    return (
        *(int(row.id), str(row.kind), int(row.i), int(row.j), int(row.opposing), int(row.kept), str(row.reason)),
        *(_blob(row.i_from_j), _blob(row.covariance), int(row.inliers), int(row.matches)),
        *(None if math.isnan(row.distance) else _real(row.distance), int(has_arrays)),
    )


def read_keyframes(database: sqlite3.Connection, session: int | None) -> Keyframes:
    """The keyframes of a session, or all, with their settled poses."""
    where = "WHERE session = ?"
    rows = get_all(database, "keyframes") if session is None else get(database, "keyframes", where, (session,))
    ids, sessions, frames, stamps, names, poses = _columns(rows, 6)
    number = _integers(ids)
    pose = _doubles(poses, 3)
    for block, packed in get_all(database, "settled"):
        settled = np.frombuffer(packed, "<f8").reshape(-1, 3)
        first, last = np.searchsorted(number, (block * BLOCK, (block + 1) * BLOCK))
        ours = settled[number[first:last] - block * BLOCK]
        pose[first:last] = np.where(np.isnan(ours), pose[first:last], ours)
    return Keyframes(number, _integers(sessions), _integers(frames), np.array(stamps, float), tuple(names), pose)


def read_frames(database: sqlite3.Connection, session: int | None) -> Frames:
    """The frames between the keyframes of a session, or all."""
    where = "WHERE keyframe IN (SELECT id FROM keyframes WHERE session = ?)"
    rows = get_all(database, "frames") if session is None else get(database, "frames", where, (session,))
    _, frames, stamps, names, keyframes, poses = _columns(rows, 6)
    return Frames(_integers(frames), np.array(stamps, float), tuple(names), _integers(keyframes), _doubles(poses, 3))


def read_edges(database: sqlite3.Connection, kind: str | None) -> Edges:
    """The edges of a kind, or all."""
    rows = get_all(database, "edges") if kind is None else get(database, "edges", "WHERE kind = ?", (kind,))
    columns = _columns(rows, 13)
    ids, kinds, i, j, opposing, kept, reasons, poses, covariances, inliers, matches, distances, _ = columns
    return Edges(
        *(_integers(ids), tuple(kinds), _integers(i), _integers(j), _integers(opposing) != 0, _integers(kept) != 0),
        *(tuple(reasons), _doubles(poses, 3), _doubles(covariances, 9).reshape(-1, 3, 3), _integers(inliers)),
        *(_integers(matches), np.array([math.nan if value is None else value for value in distances], float)),
    )


def settle_poses(database: sqlite3.Connection, ids: Int[np.ndarray, " n"], poses: Float[np.ndarray, "n 3"]) -> None:
    """Writes settled poses; NaN takes one back."""
    if not len(ids):
        return
    order = np.argsort(ids, kind="stable")
    blocks, starts = np.unique(ids[order] // BLOCK, return_index=True)
    changed, new = [], 0
    for block, ours in zip(blocks.tolist(), np.split(order, starts[1:]), strict=True):
        found = list(get(database, "settled", "WHERE id = ?", (block,)))
        settled = np.frombuffer(found[0][1], "<f8").reshape(-1, 3).copy() if found else np.full((BLOCK, 3), np.nan)
        settled[ids[ours] - block * BLOCK] = poses[ours]
        changed.append((block, _blob(settled)))
        new += not found
    put(database, "settled", changed, replace=True)
    count(database, settled=new)


def settle_edges(
    database: sqlite3.Connection, ids: Iterable[int], kept: Iterable[bool], reasons: Iterable[str]
) -> list[int]:
    """Writes which edges are kept and why; returns the ids that are not there."""
    changed, missing = [], []
    for number, keep, reason in zip(ids, kept, reasons, strict=True):
        found = list(get(database, "edges", "WHERE id = ?", (int(number),)))
        if found:
            changed.append((*found[0][:5], int(keep), str(reason), *found[0][7:]))
        else:
            missing.append(int(number))
    put(database, "edges", changed, replace=True)
    return missing


def _columns(rows: Iterable[tuple], width: int) -> list[tuple]:
    return list(zip(*rows, strict=True)) or [()] * width


def _integers(values: Iterable[int]) -> np.ndarray:
    return np.array(list(values), np.int64)


def _doubles(blobs: Iterable[bytes], width: int) -> np.ndarray:
    return np.frombuffer(b"".join(blobs), "<f8").reshape(-1, width).astype(np.float64)


def _blob(values: np.ndarray) -> bytes:
    return np.asarray(values, "<f8").tobytes()


def _real(value: float) -> float:
    return float(value) + 0.0  # a REAL column loses the sign of zero
