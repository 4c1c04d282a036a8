"""g2o (and TORO) pose-graph files: text to `PoseGraph` and back. Host code; nothing is written here.

    VERTEX_SE2 id x y theta                 EDGE_SE2 i j dx dy dtheta I11 I12 I13 I22 I23 I33
    VERTEX_SE3:QUAT id x y z qx qy qz qw    EDGE_SE3:QUAT i j, pose, 21 numbers: upper triangle of the information
    FIX id [id ...]                         # comment
    VERTEX2, EDGE2 (TORO)                   as SE2, the information in the order I11 I12 I22 I33 I13 I23

Units m and rad. Ids may be sparse and unsorted: rows follow the vertices' order in the file, ids are kept beside them.
"""

import warnings
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ebjax.posegraph.graph import PoseGraph, make_graph
from ebjax.posegraph.init import odometry, spanning_tree

_VERTICES = {"VERTEX_SE2": 3, "VERTEX_SE3:QUAT": 7, "VERTEX2": 3}
_EDGES = {"EDGE_SE2": (3, 6), "EDGE_SE3:QUAT": (7, 21), "EDGE2": (3, 6)}


def read_g2o(path: str | PathLike) -> tuple[PoseGraph, Int[np.ndarray, " N"]]:
    """Reads a graph in float64 and the ids of its rows.

    Every edge is marked robust; FIX sets `fixed`. Vertices that only edges name start where the fewest edges put them,
    from those that are given, with a warning, and rows are then ordered by id; without any vertex the start is
    odometry. Lines that carry no constraint (PARAMS_..., comments) are skipped.

    Raises:
      ValueError: names the file, the line and what to do about it.
    """
    return parse_g2o(Path(path).read_text(errors="replace"), str(path))


def parse_g2o(text: str, name: str = "g2o text") -> tuple[PoseGraph, Int[np.ndarray, " N"]]:
    """As `read_g2o`, from a string; `name` stands for the file in errors."""
    vertices: dict[int, list[float]] = {}
    edges: list[tuple[int, int, int]] = []
    numbers: list[list[float]] = []
    fixes: list[tuple[int, int]] = []
    size, seen = 0, ""
    for line, row in enumerate(text.splitlines(), 1):
        tokens = row.split()
        tag = tokens[0] if tokens else "#"
        if tag in _EDGES or tag in _VERTICES:
            width, extra, ids = (*_EDGES[tag], 2) if tag in _EDGES else (_VERTICES[tag], 0, 1)
            if size and width != size:
                raise ValueError(f"{name}:{line}: {tag} in a graph of {seen}; keep one of SE2 and SE3 per file")
            size, seen = width, tag
            if len(tokens) != 1 + ids + width + extra:
                raise ValueError(
                    f"{name}:{line}: {tag} has {len(tokens) - 1} numbers, needs {ids + width + extra}; "
                    "restore the line or delete it"
                )
            try:
                key = [int(t) for t in tokens[1 : 1 + ids]]
                values = [float(t) for t in tokens[1 + ids :]]
            except ValueError:
                raise ValueError(
                    f"{name}:{line}: {tag} holds something that is not a number; correct the line"
                ) from None
            if ids == 2:
                edges.append((key[0], key[1], line))
                numbers.append(_from_toro(values) if tag == "EDGE2" else values)
            elif vertices.setdefault(key[0], values) is not values:
                raise ValueError(f"{name}:{line}: vertex {key[0]} appears twice; delete one of the two lines")
            elif not np.isfinite(values).all():
                raise ValueError(f"{name}:{line}: {tag} {key[0]} is not finite; correct the line")
        elif tag == "FIX":
            try:
                fixes += [(int(t), line) for t in tokens[1:]]
            except ValueError:
                raise ValueError(f"{name}:{line}: FIX takes vertex ids; correct the line") from None
        elif tag.startswith(("EDGE", "VERTEX")):
            known = ", ".join([*_VERTICES, *_EDGES])
            raise ValueError(f"{name}:{line}: {tag} is not supported (known: {known}); delete or convert such lines")
    if not seen:
        raise ValueError(f"{name}: holds no vertices and no edges; give a g2o file")
    return _build(name, size, vertices, edges, np.array(numbers, float), fixes)


def _from_toro(values):
    x, y, t, i11, i12, i22, i33, i13, i23 = values
    return [x, y, t, i11, i12, i13, i22, i23, i33]


def _build(name, size, vertices, edges, numbers, fixes):
    dim = 3 if size == 3 else 6
    numbers = numbers.reshape(len(edges), size + dim * (dim + 1) // 2)
    lines = [line for _, _, line in edges]
    named = vertices.keys() | {p for a, b, _ in edges for p in (a, b)}
    ids = list(vertices) if len(named) == len(vertices) else sorted(named)
    row = {p: k for k, p in enumerate(ids)}
    for a, b, line in edges:
        if a == b:
            raise ValueError(f"{name}:{line}: edge joins vertex {a} with itself; delete the line")
    bad = ~np.isfinite(numbers).all(1)
    if bad.any():
        raise ValueError(
            f"{name}:{lines[int(np.argmax(bad))]}: edge holds a number that is not finite; correct the line"
        )
    upper = np.zeros((len(edges), dim, dim))
    upper[(slice(None), *np.triu_indices(dim))] = numbers[:, size:]
    information = upper + np.triu(upper, 1).swapaxes(1, 2)
    if len(edges):
        bad = np.linalg.eigvalsh(information)[:, 0] <= 0
        if bad.any():
            more = f" (and in {bad.sum() - 1} more edges)" if bad.sum() > 1 else ""
            raise ValueError(
                f"{name}:{lines[int(np.argmax(bad))]}: information matrix is not positive definite{more}; "
                "give every edge a full inverse covariance"
            )
    known, nowhere = np.array([p in vertices for p in ids]), [0.0] * (size - 1) + [float(size == 7)]
    poses = _from_file(np.array([vertices.get(p, nowhere) for p in ids]), size)
    if size == 7:
        norms = np.linalg.norm(numbers[:, 3:7], axis=1)
        if (norms < 1e-3).any():
            raise ValueError(f"{name}:{lines[int(np.argmax(norms < 1e-3))]}: quaternion is zero; correct the line")
        if (np.linalg.norm(poses[:, :4], axis=1) < 1e-3).any() or not np.isfinite(poses).all():
            k = int(np.argmax(~(np.linalg.norm(poses[:, :4], axis=1) >= 1e-3)))
            raise ValueError(f"{name}: vertex {ids[k]} has a zero quaternion; correct its line")
    fixed = np.zeros(len(ids), bool)
    for p, line in fixes:
        if p not in row:
            raise ValueError(f"{name}:{line}: FIX names vertex {p}, which the file does not hold; delete the line")
        fixed[row[p]] = True
    i, j = (np.array([row[e[k]] for e in edges], np.int64) for k in (0, 1))
    graph = make_graph(poses, i, j, _from_file(numbers[:, :size], size), information, fixed=fixed)
    if not vertices:
        graph = replace(graph, poses=odometry(graph))
    elif not known.all():
        first = ids[int(np.argmin(known))]
        more = f" and {len(ids) - known.sum() - 1} more" if known.sum() < len(ids) - 1 else ""
        warnings.warn(f"{name}: no VERTEX line for {first}{more}; they start where the edges put them", stacklevel=3)
        graph = replace(graph, poses=spanning_tree(replace(graph, fixed=known)))
    return graph, np.array(ids, np.int64)


def _from_file(values, size):
    """Translation, xyzw to our order: x y theta stays, wxyz_xyz for SE(3) with unit quaternions."""
    values = values.reshape(-1, size)
    if size == 3:
        return values
    q = values[:, [6, 3, 4, 5]]
    with np.errstate(invalid="ignore", divide="ignore"):
        q = q / np.linalg.norm(q, axis=1, keepdims=True)
    return np.concatenate([q, values[:, :3]], 1)


def format_g2o(graph: PoseGraph, ids: Int[np.ndarray, " N"] | None = None) -> str:
    """The graph as g2o text, numbers at full float64 precision; ids are row numbers where not given."""
    ids = np.arange(len(graph.poses)) if ids is None else ids
    se2 = graph.group == "se2"
    tag = "SE2" if se2 else "SE3:QUAT"
    poses, measured = (_to_file(np.asarray(x, float), se2) for x in (graph.poses, graph.measured))
    information = np.asarray(graph.information, float)
    upper = information[(slice(None), *np.triu_indices(information.shape[-1]))]
    i, j = ids[np.asarray(graph.i)], ids[np.asarray(graph.j)]
    out = [f"VERTEX_{tag} {p} {_text(x)}" for p, x in zip(ids.tolist(), poses.tolist(), strict=True)]
    out += [f"FIX {p}" for p in ids[np.asarray(graph.fixed)].tolist()]
    rows = np.concatenate([measured, upper], 1).tolist()
    out += [f"EDGE_{tag} {a} {b} {_text(x)}" for a, b, x in zip(i.tolist(), j.tolist(), rows, strict=True)]
    return "\n".join(out) + "\n"


def _to_file(values: Float[np.ndarray, "N P"], se2: bool):
    return values if se2 else values[:, [4, 5, 6, 1, 2, 3, 0]]


def _text(row):
    return " ".join(map(repr, row))
