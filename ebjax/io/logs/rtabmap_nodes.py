"""The nodes of an RTAB-Map database: which session is run, which nodes have images, and their poses."""

import sqlite3
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ebjax.io.logs.rtabmap_calibration import transform_from_floats
from ebjax.io.logs.rtabmap_database import columns
from ebjax.io.trajectory import Trajectory

INTERMEDIATE, INVALID = -1, -9
MOST_S = 1e12
"""A stamp beyond it is no time."""


@dataclass(frozen=True)
class Node:
    """A node. `pose` is base_link in the odometry frame, `truth` in the world; both the 48 bytes of the database."""

    id: int
    session: int
    weight: int
    stamp: float
    pose: object
    truth: object
    has_image: bool
    has_depth: bool


def read_nodes(database: sqlite3.Connection) -> list[Node]:
    """Reads every node in order of its number, without image data. Raises SQLite's error where a number is none."""
    truth = "Node.ground_truth_pose" if "ground_truth_pose" in columns(database, "Node") else "NULL"
    weight = "COALESCE(Node.weight, 0)" if "weight" in columns(database, "Node") else "0"
    depth = "length(Data.depth)" if "depth" in columns(database, "Data") else "NULL"
    rows = database.execute(
        f"SELECT Node.id, Node.map_id, {weight}, Node.stamp, Node.pose, {truth}, length(Data.image), {depth} "
        "FROM Node LEFT JOIN Data ON Data.id = Node.id ORDER BY Node.id"
    )
    nodes = []
    for i, session, weight, stamp, pose, true, image, depth in rows:
        numbers = isinstance(stamp, int | float | None) and all(isinstance(n, int) for n in (i, session, weight))
        if not numbers:
            raise sqlite3.DatabaseError(f"node {i} has values that are no numbers")
        seconds = float("nan") if stamp is None or abs(stamp) > MOST_S else float(stamp)
        nodes.append(Node(i, session, weight, seconds, pose, true, bool(image), bool(depth)))
    return nodes


def sessions(nodes: Sequence[Node]) -> dict[int, int]:
    """Counts the images of each session, in order of the sessions' numbers."""
    images = dict.fromkeys(sorted({node.session for node in nodes}), 0)
    for node in nodes:
        images[node.session] += node.has_image and node.weight >= 0
    return images


def chosen_session(path: Path, images: dict[int, int], session: int | None) -> tuple[int, list[str]]:
    """Chooses the session to run: the given one, else the one with most images. Returns it with notes.

    Raises:
      ValueError: there is no such session; names those that are there.
    """
    if session is not None and session not in images:
        raise ValueError(f"{path}: no session {session}; give one of {', '.join(map(str, images))}")
    chosen = max(images, key=images.__getitem__) if session is None else session
    others = [f"{number} ({count} images)" for number, count in images.items() if number != chosen]
    if not others:
        return chosen, []
    why = "the one with most images" if session is None else "as given"
    return chosen, [
        f"{path}: session {chosen} is run, {why}; left out: {', '.join(others)}. "
        "Odometry restarts between sessions: run each by its number"
    ]


def in_time_order(path: Path, nodes: Sequence[Node]) -> tuple[list[Node], list[str]]:
    """Leaves out nodes whose stamp does not exceed the stamps before it; a note says how many."""
    latest, kept = -np.inf, []
    for node in nodes:
        if node.stamp > latest:
            latest = node.stamp
            kept.append(node)
    lost = len(nodes) - len(kept)
    return kept, [f"{path}: {lost} nodes left out, their stamps are not later than those before"] if lost else []


def pose_from_blob(blob: object) -> Float[np.ndarray, "4 4"] | None:
    """Reads 12 float32, row-major 3x4; None where it is null (no odometry) or not a pose."""
    if not isinstance(blob, bytes) or len(blob) != 48:
        return None
    try:
        return transform_from_floats(np.frombuffer(blob, "<f4").astype(np.float64))
    except ValueError:
        return None


def trajectory(path: Path, nodes: Sequence[Node], blob: Callable[[Node], object]) -> Trajectory | None:
    """The poses of the nodes that have one, or None where none has.

    Args:
      path: of the database.
      nodes: of one session, in time order.
      blob: which of a node's poses.
    """
    found = [(node.stamp, pose) for node in nodes if (pose := pose_from_blob(blob(node))) is not None]
    if not found:
        return None
    return Trajectory(np.array([stamp for stamp, _ in found]), np.stack([pose for _, pose in found]), str(path))


def skipped_notes(path: Path, nodes: Sequence[Node]) -> list[str]:
    """What was skipped: nodes by their weight, nodes without an image or without a pose."""
    weights = Counter(node.weight for node in nodes)
    empty = sum(not node.has_image and node.weight >= 0 for node in nodes)
    poseless = sum(pose_from_blob(node.pose) is None and node.weight > INVALID for node in nodes)
    facts = [
        (weights[INTERMEDIATE], "nodes of weight -1 (between two nodes) give no image, only odometry"),
        (weights[INVALID], "nodes of weight -9 (left out by RTAB-Map) skipped"),
        (empty, "nodes without an image skipped"),
        (poseless, "nodes have no odometry pose"),
    ]
    return [f"{path}: {count} {words}" for count, words in facts if count]
