"""What an RTAB-Map database holds in all, in lines: version, sessions, cameras, depth, links."""

import sqlite3
from collections import Counter
from collections.abc import Sequence

from ebjax.io.logs.rtabmap_calibration import DatabaseCamera
from ebjax.io.logs.rtabmap_camera import described
from ebjax.io.logs.rtabmap_depth import DepthHead
from ebjax.io.logs.rtabmap_nodes import Node, sessions

LINKS = {
    0: "neighbour (odometry)",
    1: "global closure",
    2: "local closure in space",
    3: "local closure in time",
    4: "user closure",
    5: "virtual closure",
    6: "merged neighbour",
    7: "pose prior",
    8: "landmark",
    9: "gravity",
}
CLOSURES = (1, 2, 3, 4)


def links_by_type(database: sqlite3.Connection) -> tuple[Counter[int], Counter[int]]:
    """Counts the links by type, and the closures by session; a link in both directions is one."""
    sessions_of = dict(database.execute("SELECT id, map_id FROM Node"))
    pairs = database.execute(
        "SELECT DISTINCT type, min(from_id, to_id), max(from_id, to_id) FROM Link WHERE typeof(type) = 'integer'"
    )
    types: Counter[int] = Counter()
    closures: Counter[int] = Counter()
    for kind, one, other in pairs:
        types[kind] += 1
        if kind in CLOSURES:
            closures.update({sessions_of[node] for node in (one, other) if node in sessions_of})
    return types, closures


def contents_of(
    database: sqlite3.Connection,
    version: tuple[int, ...],
    nodes: Sequence[Node],
    cameras: Sequence[DatabaseCamera],
    depth: DepthHead | None,
) -> tuple[str, ...]:
    """Lists the contents, a line each."""
    types, closures = links_by_type(database)
    of_session = Counter(node.session for node in nodes)
    lines = [f"RTAB-Map {'.'.join(map(str, version))}"]
    for number, count in sessions(nodes).items():
        lines.append(f"session {number}: {of_session[number]} nodes, {count} images, {closures[number]} closures")
    lines += [f"camera {number}: {described(camera)}" for number, camera in enumerate(cameras)]
    if depth is not None:
        words = {"rvl": "RVL, millimetres", "millimetres": "PNG, millimetres", "float": "PNG, float metres"}
        lines.append(f"depth: {depth.width} x {depth.height} px, {words[depth.kind]}")
    lines += [f"links: {count} {LINKS.get(kind, f'of type {kind}')}" for kind, count in sorted(types.items())]
    return tuple(lines)
