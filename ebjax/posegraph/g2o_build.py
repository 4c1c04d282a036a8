"""From the lines of a g2o file to a graph: which vertices are poses, which landmarks, and where they start."""

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Int

from ebjax.posegraph.g2o_information import file_poses, note_norms, numbers_of, rotation_scale
from ebjax.posegraph.g2o_lines import Lines, Measured
from ebjax.posegraph.g2o_tags import POINTS
from ebjax.posegraph.graph import PoseGraph, make_graph
from ebjax.posegraph.init import odometry, spanning_tree

_BETWEEN_POINTS = ("EDGE_POINTXY", "EDGE_POINTXYZ")
_OF_POINTS = ("EDGE_PRIOR_XY", "EDGE_POINTXY_PRIOR", "EDGE_POINTXYZ_PRIOR", "EDGE_PRIOR_XYZ")


def build(found: Lines, convention: str) -> tuple[PoseGraph, Int[np.ndarray, " M"]]:
    """The graph in float64, and the ids of its poses and landmarks; adds to `found.notes`.

    Raises:
      ValueError: lines that do not go together; names one and what to do about it.
    """
    points = _points(found)
    named = found.vertices.keys() | {p for edge in found.edges for p in edge.ends}
    order = list(found.vertices) if len(named) == len(found.vertices) else sorted(named)
    ids = [p for p in order if p not in points] + [p for p in order if p in points]
    row = {p: k for k, p in enumerate(ids)}
    world = any(edge.form.ends == 1 for edge in found.edges)
    for edge in found.edges:
        _check_ends(edge, points, found.name)
    poses, known = _start(found, ids, world)
    i = np.array([row[e.ends[0]] if e.form.ends == 2 else len(ids) for e in found.edges], np.int64)
    j = np.array([row[e.ends[-1]] for e in found.edges], np.int64)
    position = np.array([e.form.layout in POINTS for e in found.edges], bool)
    scale = rotation_scale(convention, found.planar, world or bool(points))
    measured, information = numbers_of(found, scale)
    if scale != 1 and convention == "auto" and any(e.form.layout == "quat" for e in found.edges):
        found.notes.append(
            "holds priors or landmarks, so information of rotations is read as g2o means it, of the quaternion's "
            "vector part; --information gtsam reads it as of the rotation vector"
        )
    fixed = np.zeros(len(poses), bool)
    for p, line in found.fixes:
        if p not in row:
            raise ValueError(
                f"{found.name}:{line}: FIX names vertex {p}, which the file does not hold; delete the line"
            )
        fixed[row[p]] = True
    _note_equivalent(found)
    landmark = np.array([p in points for p in ids] + [False] * world)
    if world:
        fixed[-1] = True
    marks: dict[str, Any] = {
        "position": position if position.any() else None,
        "landmark": landmark if points else None,
    }
    graph = replace(make_graph(poses, i, j, measured, information, fixed=fixed, **marks), world=world)
    if not found.vertices:
        graph = replace(graph, poses=odometry(graph))
    elif not known.all():
        first = ids[int(np.argmin(known))]
        more = f" and {(~known).sum() - 1} more" if (~known).sum() > 1 else ""
        found.notes.append(f"no VERTEX line for {first}{more}; they start where the edges put them")
        graph = replace(graph, poses=spanning_tree(replace(graph, fixed=known)))
    return graph, np.array(ids, np.int64)


def _points(found: Lines) -> set[int]:
    """Ids of landmarks: by their VERTEX line, or by being measured as points only."""
    poses: set[int] = set()
    for edge in found.edges:
        if edge.form.layout not in POINTS:
            poses.update(edge.ends)
        elif edge.tag not in (*_BETWEEN_POINTS, *_OF_POINTS):
            poses.add(edge.ends[0])
    named = {p for edge in found.edges for p in edge.ends}
    given = {p for p, vertex in found.vertices.items() if vertex.layout in POINTS}
    return given | (named - poses - found.vertices.keys())


def _check_ends(edge: Measured, points: set[int], name: str) -> None:
    where = f"{name}:{edge.line}: {edge.tag}"
    if edge.form.layout not in POINTS:
        for p in edge.ends:
            if p in points:
                raise ValueError(f"{where} names vertex {p}, a landmark without rotation; give a pose")
    elif edge.form.ends == 2 and (edge.ends[0] in points) != (edge.tag in _BETWEEN_POINTS):
        kind = "a landmark" if edge.ends[0] in points else "a pose"
        wanted = "the pose that measures" if kind == "a landmark" else "a landmark"
        raise ValueError(f"{where} begins with vertex {edge.ends[0]}, {kind}; put {wanted} first")


def _start(found, ids, world):
    """Poses of all rows, the identity where the file has none, and which it has."""
    width = 3 if found.planar else 7
    identity = np.eye(width)[0] if width == 7 else np.zeros(width)
    poses = np.tile(identity, (len(ids) + world, 1))
    known = np.array([p in found.vertices for p in ids] + [True] * world)
    by_layout: dict[str, list[int]] = {}
    for k, p in enumerate(ids):
        if p in found.vertices:
            by_layout.setdefault(found.vertices[p].layout, []).append(k)
    for layout, rows in by_layout.items():
        values = np.array([found.vertices[ids[k]].values for k in rows])
        note_norms(found, layout, values, [found.vertices[ids[k]].line for k in rows])
        poses[rows] = file_poses(values, layout)
    return poses, known


def _note_equivalent(found: Lines) -> None:
    """TORO merges the vertices of EQUIV along the edge that joins them; that edge measures the same without it."""
    joined = {frozenset(edge.ends) for edge in found.edges}
    for a, b, line in found.equivalent:
        if frozenset((a, b)) not in joined:
            raise ValueError(
                f"{found.name}:{line}: EQUIV {a} {b} merges vertices that no edge joins; add an edge or delete the line"
            )
    if found.equivalent:
        a, b, line = found.equivalent[0]
        more = f" and {len(found.equivalent) - 1} more" if len(found.equivalent) > 1 else ""
        found.notes.append(f"line {line}: EQUIV {a} {b}{more}: the vertices stay two, joined by their edge as measured")
