"""The vertices of a pose graph (g2o, TORO) as poses, in file order; edges and landmarks are left out.

    VERTEX_SE2 or VERTEX2 id x y theta      VERTEX_SE3:QUAT id x y z qx qy qz qw      VERTEX3 id x y z roll pitch yaw

Units m and rad. A tag may begin with ONLINE_ or TUTORIAL_, as g2o's interactive and tutorial programs write it.
"""

from collections import Counter
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ebjax.io.poses import poses_from, quaternion_from_angles, rotation_from_quaternion
from ebjax.io.text import data_lines, floats

NUMBERS = {"VERTEX_SE2": 3, "VERTEX2": 3, "VERTEX_SE3:QUAT": 7, "VERTEX3": 6}
LANDMARKS = ("VERTEX_XY", "VERTEX_TRACKXYZ", "VERTEX_POINT_XY", "VERTEX_POINTXYZ", "VERTEX_CAM", "VERTEX_SE3:EXPMAP")
TAGS = ("VERTEX", "EDGE", "ONLINE_", "TUTORIAL_", "FIX ", "PARAMS_")


def is_pose_graph(lines: list[tuple[int, str]]) -> bool:
    """Whether lines of a file are those of a pose graph."""
    return any(line.startswith(TAGS) for _, line in lines)


def read_vertices(path: str | Path) -> tuple[Float[np.ndarray, "N 4 4"], tuple[str, ...]]:
    """Reads the poses and says what was left out or converted.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: no vertices, two kinds of them, what is no number or no rotation; names file and line.
    """
    rows, others, first, decimal = [], Counter[str](), "", False
    for number, line in data_lines(path):
        written, *fields = line.split("#")[0].split()
        tag = written.removeprefix("ONLINE_").removeprefix("TUTORIAL_")
        if tag not in NUMBERS:
            if tag.startswith("VERTEX"):
                others[written] += 1
            continue
        first = first or tag
        if NUMBERS[tag] != NUMBERS[first] or len(fields) - 1 != NUMBERS[tag]:
            raise ValueError(
                f"{path} line {number}: a {written} line with {max(len(fields) - 1, 0)} numbers after the id; "
                f"{tag} has {NUMBERS[tag]}, and one kind a file"
            )
        decimal |= any("," in field for field in fields)
        rows.append((number, floats(path, number, [field.replace(",", ".") for field in fields[1:]])))
    if not rows:
        known = ", ".join(NUMBERS)
        raise ValueError(f"{path}: no vertices with poses ({known}); give a pose graph with vertices")
    notes = [f"{path}: commas are decimal, read as points"] * decimal
    notes += [f"{path}: {count} {tag} lines, no poses of the path, are left out" for tag, count in others.items()]
    return _poses(path, rows), tuple(notes)


def _poses(path: str | Path, rows: list[tuple[int, list[float]]]) -> Float[np.ndarray, "N 4 4"]:
    table = np.array([values for _, values in rows])
    zero = np.zeros((len(table), 1))
    if table.shape[1] == 3:
        table = np.concatenate([table[:, :2], zero, zero, zero, table[:, 2:]], axis=1)
    if table.shape[1] == 6:
        return poses_from(rotation_from_quaternion(quaternion_from_angles(table[:, 3:])), table[:, :3])
    wrong = np.flatnonzero(np.abs(np.linalg.norm(table[:, 3:], axis=1) - 1) > 0.05)
    if wrong.size:
        raise ValueError(
            f"{path} line {rows[wrong[0]][0]}: the quaternion's length is not 1; its order is qx qy qz qw; "
            "correct the line"
        )
    return poses_from(rotation_from_quaternion(table[:, [6, 3, 4, 5]]), table[:, :3])
