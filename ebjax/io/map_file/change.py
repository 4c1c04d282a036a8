"""Changes that go through a whole map: a session forgotten, arrays dropped or made anew."""

import json
import sqlite3
from collections.abc import Callable, Mapping

import numpy as np

from ebjax.io.map_file.columns import settle_poses
from ebjax.io.map_file.packed import pack, unpack
from ebjax.io.map_file.rows import Arrays
from ebjax.io.map_file.schema import count_anew, get, put

Change = Callable[[int, dict[str, np.ndarray]], Arrays | None]


def forget_session(database: sqlite3.Connection, session: int) -> None:
    """Deletes a session with its keyframes, the frames they place, and every edge that touches one of them."""
    ids = np.array([number for (number,) in database.execute("SELECT id FROM keyframes WHERE session = ?", (session,))])
    ours = "(SELECT id FROM keyframes WHERE session = :session)"
    edges = f"(SELECT id FROM edges WHERE i IN {ours} OR j IN {ours})"
    for statement in (
        f"edge_arrays WHERE id IN {edges}",
        f"edges WHERE id IN {edges}",
        f"frames WHERE keyframe IN {ours}",
        f"keyframe_arrays WHERE id IN {ours}",
        "keyframes WHERE session = :session",
        "state WHERE session = :session",
        "sessions WHERE id = :session",
    ):
        database.execute(f"DELETE FROM {statement}", {"session": session})
    if len(ids):  # last, when pages are free to write to
        settle_poses(database, ids.astype(np.int64), np.full((len(ids), 3), np.nan))
    count_anew(database)


def change_keyframe_arrays(database: sqlite3.Connection, change: Change) -> int:
    """Puts `change(keyframe, arrays)` in place of the arrays of each, None leaves them; returns how many changed."""
    changed = 0
    for (number,) in database.execute("SELECT id FROM keyframe_arrays ORDER BY id").fetchall():
        ((_, packed),) = get(database, "keyframe_arrays", "WHERE id = ?", (number,))
        new = change(number, unpack(packed))
        if new is not None:
            put(database, "keyframe_arrays", [(number, pack(new))], replace=True)
            changed += 1
    return changed


def put_facts(database: sqlite3.Connection, facts: Mapping[str, object]) -> None:
    """Writes what must agree with whoever goes on with the map."""
    put(database, "map", [(1, json_of(facts))], replace=True)


def json_of(facts: Mapping[str, object]) -> str:
    """Facts as JSON.

    Raises:
      ValueError: a value that JSON does not hold.
    """
    try:
        return json.dumps(dict(facts), allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"facts of a map must be plain values as JSON holds them: {error}") from None
