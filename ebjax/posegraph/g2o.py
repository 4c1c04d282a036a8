"""g2o pose-graph files, of every program that writes them, and TORO's: text to `PoseGraph` and back. Host code.

    VERTEX_SE2 id x y theta                  EDGE_SE2 i j dx dy dtheta I11 I12 I13 I22 I23 I33
    VERTEX_SE3:QUAT id x y z qx qy qz qw     EDGE_SE3:QUAT i j, pose, 21 numbers: upper triangle of the information
    VERTEX_XY id x y                         EDGE_SE2_XY i j x y + 3: a landmark, seen from pose i
    VERTEX_TRACKXYZ id x y z                 EDGE_SE3_TRACKXYZ i j offset x y z + 6
    EDGE_PRIOR_SE2 i x y theta + 6           EDGE_SE3_PRIOR i offset, pose + 21: where pose i lies in the world
    EDGE_PRIOR_SE2_XY i x y + 3              EDGE_POINTXYZ_PRIOR i x y z + 6: its position alone
    PARAMS_SE3OFFSET id, pose                a sensor's offset, base_from_sensor
    FIX id [id ...]                          # comment

All that is read stands in `ebjax.posegraph.g2o_tags`. Units m and rad. Ids may be sparse and unsorted: rows follow the
vertices' order in the file, landmarks behind poses, ids are kept beside them. Decimal commas, gzip, a byte order mark,
tags in lower case and quaternions of any length are taken.

Information is of the residual log(measured^-1 * i_from_j). In 2D all programs mean that, to first order. In 3D g2o's
own error is (t, q), q the vector part of the quaternion, half of the rotation vector w: information I of (t, q) is
S I S of (t, w), S = diag(1, 1, 1, 1/2, 1/2, 1/2). gtsam, Ceres and most public data sets write the same lines with
information of (t, w). So `information` "auto" reads files with priors or landmarks, which only g2o's programs write, as
"g2o", all others as "gtsam"; graphs are written in the terms in which they are read. TORO's EDGE3 has (w, t).
"""

import warnings
from os import PathLike
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ebjax.posegraph.g2o_build import build
from ebjax.posegraph.g2o_information import rotation_scale
from ebjax.posegraph.g2o_lines import parse_lines, read_text
from ebjax.posegraph.graph import PoseGraph


def read_g2o(path: str | PathLike, *, information: str = "auto") -> tuple[PoseGraph, Int[np.ndarray, " N"]]:
    """Reads a graph in float64 and the ids of its poses, then landmarks.

    Every edge is marked robust; FIX sets `fixed`. Where the file has priors, one more row stands behind those with ids:
    the world. Vertices that only edges name start where the fewest edges put them, from those that are given, with a
    warning, and rows are then ordered by id; without any vertex the start is odometry. What is guessed or left out is a
    warning.

    Args:
      path: the file, also packed by gzip.
      information: "g2o", "gtsam" or "auto": what information of 3D rotations is of; see the module.

    Raises:
      OSError: the file cannot be read.
      ValueError: names the file, the line and what to do about it.
    """
    return parse_g2o(read_text(Path(path)), str(path), information=information)


def parse_g2o(
    text: str, name: str = "g2o text", *, information: str = "auto"
) -> tuple[PoseGraph, Int[np.ndarray, " N"]]:
    """As `read_g2o`, from a string; `name` stands for the file in errors."""
    found = parse_lines(text, name)
    graph, ids = build(found, information)
    for note in found.notes:
        warnings.warn(f"{name}: {note}", stacklevel=3)
    return graph, ids


def format_g2o(graph: PoseGraph, ids: Int[np.ndarray, " M"] | None = None, *, information: str = "auto") -> str:
    """The graph as g2o text, numbers at full float64 precision; ids are row numbers where not given.

    Offsets of sensors are written as part of the measurements they were of.
    """
    world = len(graph.poses) - 1 if graph.world else -1
    rows = len(graph.poses) - graph.world
    ids = np.arange(rows) if ids is None else np.asarray(ids)
    planar = graph.group == "se2"
    point = np.zeros(rows, bool) if graph.landmark is None else np.asarray(graph.landmark)[:rows]
    position = np.zeros(len(graph.i), bool) if graph.position is None else np.asarray(graph.position)
    scale = rotation_scale(information, planar, graph.world or bool(point.any()))
    poses, measured = (_to_file(np.asarray(x, float), planar) for x in (graph.poses, graph.measured))
    matrices = np.asarray(graph.information, float) / _squared(scale, graph.lie.dim)
    space = graph.lie.dim // 3 + 1
    upper = matrices[(slice(None), *np.triu_indices(graph.lie.dim))].tolist()
    corner = matrices[(slice(None), *np.triu_indices(space))].tolist()
    vertex, landmark = ("VERTEX_SE2", "VERTEX_XY") if planar else ("VERTEX_SE3:QUAT", "VERTEX_TRACKXYZ")
    offset = "" if planar else " 0"
    out = ["PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1"] if not planar and position.any() | graph.world else []
    for p, x, is_point in zip(ids.tolist(), poses[:rows].tolist(), point.tolist(), strict=True):
        out.append(f"{landmark} {p} {_text(x[:space])}" if is_point else f"{vertex} {p} {_text(x)}")
    out += [f"FIX {p}" for p in ids[np.asarray(graph.fixed)[:rows]].tolist()]
    edges = (np.asarray(x).tolist() for x in (graph.i, graph.j, position, measured))
    for k, (i, j, place, z) in enumerate(zip(*edges, strict=True)):
        numbers = _text(z[:space] + corner[k] if place else z + upper[k])
        if i == world:
            out.append(f"{_prior(planar, place, point[j])} {ids[j]}{_offset_of(planar, place, point[j])} {numbers}")
        elif place and point[i]:
            out.append(f"{'EDGE_POINTXY' if planar else 'EDGE_POINTXYZ'} {ids[i]} {ids[j]} {numbers}")
        elif place:
            out.append(f"{'EDGE_SE2_XY' if planar else 'EDGE_SE3_TRACKXYZ'} {ids[i]} {ids[j]}{offset} {numbers}")
        else:
            out.append(f"{'EDGE_SE2' if planar else 'EDGE_SE3:QUAT'} {ids[i]} {ids[j]} {numbers}")
    return "\n".join(out) + "\n"


def _prior(planar, place, point):
    if not place:
        return "EDGE_PRIOR_SE2" if planar else "EDGE_SE3_PRIOR"
    if planar:
        return "EDGE_PRIOR_XY" if point else "EDGE_PRIOR_SE2_XY"
    return "EDGE_POINTXYZ_PRIOR" if point else "EDGE_SE3_XYZ_PRIOR"


def _offset_of(planar, place, point):
    """g2o's priors on 3D poses name an offset, priors on points and planar ones do not."""
    return "" if planar or (place and point) else " 0"


def _squared(scale, dim):
    by = np.ones(dim)
    by[dim // 2 :] = scale if dim == 6 else 1
    return by[:, None] * by


def _to_file(values: Float[np.ndarray, "N P"], planar: bool):
    return values if planar else values[:, [4, 5, 6, 1, 2, 3, 0]]


def _text(row):
    return " ".join(map(repr, row))
