"""Trajectories in files: TUM, KITTI, planar rows `x y theta_deg` and g2o vertices; TUM and KITTI are written too.

TUM: `timestamp tx ty tz qx qy qz qw`, `#` comments. KITTI: the first three rows of the 4x4 pose, row-major, no times.
Every reader takes .gz. A pose maps the moving frame into the fixed one, metres.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ebjax.io.atomic import whole_file
from ebjax.io.poses import poses_from, quaternion_from_rotation, rigid_fault, rotation_from_quaternion
from ebjax.io.text import check_increasing, data_lines, floats


@dataclass(frozen=True)
class Trajectory:
    """Poses in time order.

    Attributes:
      timestamps: s; row numbers 0, 1, 2, ... where the file has no times.
      poses: fixed_from_moving, metres.
      path: the file they came from.
      timed: whether the file has times.
    """

    timestamps: Float[np.ndarray, " N"]
    poses: Float[np.ndarray, "N 4 4"]
    path: str
    timed: bool = True


def _rows(path: str | Path, columns: int, layout: str) -> list[tuple[int, list[float]]]:
    rows = []
    for number, line in data_lines(path):
        fields = line.replace(",", " ").split()
        if len(fields) != columns:
            raise ValueError(f"{path} line {number}: {len(fields)} columns; a {layout} row has {columns}")
        rows.append((number, floats(path, number, fields)))
    if not rows:
        raise ValueError(f"{path}: no poses; a {layout} file has one row of {columns} numbers a pose")
    return rows


def _rotations(
    path: str | Path, numbers: list[int], quaternion: Float[np.ndarray, "N 4"]
) -> Float[np.ndarray, "N 3 3"]:
    wrong = np.flatnonzero(np.abs(np.linalg.norm(quaternion, axis=1) - 1) > 0.05)
    if wrong.size:
        raise ValueError(f"{path} line {numbers[wrong[0]]}: the quaternion's length is not 1; its order is qx qy qz qw")
    return rotation_from_quaternion(quaternion)


def _untimed(path: str | Path, poses: Float[np.ndarray, "N 4 4"]) -> Trajectory:
    return Trajectory(np.arange(len(poses), dtype=np.float64), poses, str(path), timed=False)


def _planar(x: np.ndarray, y: np.ndarray, theta_rad: np.ndarray) -> Float[np.ndarray, "N 4 4"]:
    zero = np.zeros_like(x)
    quaternion = np.stack([np.cos(theta_rad / 2), zero, zero, np.sin(theta_rad / 2)], axis=1)
    return poses_from(rotation_from_quaternion(quaternion), np.stack([x, y, zero], axis=1))


def read_tum(path: str | Path, *, repeats: bool = False) -> Trajectory:
    """Reads `timestamp tx ty tz qx qy qz qw` rows (s, m, unit quaternion); commas may separate.

    Args:
      path: the file.
      repeats: whether a timestamp may occur twice, as in some motion-capture files.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: no rows, a wrong number of columns, NaN, a quaternion that is not of length 1, unsorted or duplicate
        timestamps; names file and line.
    """
    rows = _rows(path, 8, "TUM trajectory")
    check_increasing(path, [(number, row[0]) for number, row in rows], repeats=repeats)
    table = np.array([row for _, row in rows])
    rotation = _rotations(path, [number for number, _ in rows], table[:, [7, 4, 5, 6]])
    return Trajectory(table[:, 0], poses_from(rotation, table[:, 1:4]), str(path))


def read_kitti(path: str | Path) -> Trajectory:
    """Reads KITTI rows: 12 numbers, the pose's first three rows.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: no rows, a wrong number of columns, NaN, or a row that is not a rigid transform; names file and line.
    """
    rows = _rows(path, 12, "KITTI trajectory")
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = np.array([row for _, row in rows]).reshape(-1, 3, 4)
    gram = poses[:, :3, :3] @ np.swapaxes(poses[:, :3, :3], 1, 2)
    suspect = (np.abs(gram - np.eye(3)[None]).max(axis=(1, 2)) > 1e-2) | (np.linalg.det(poses) < 0)
    for (number, _), pose in ((rows[i], poses[i]) for i in np.flatnonzero(suspect)):
        if fault := rigid_fault(pose, tolerance=1e-2):
            raise ValueError(f"{path} line {number}: not a pose, {fault}; correct or remove the line")
    return _untimed(path, poses)


def read_planar(path: str | Path) -> Trajectory:
    """Reads `x y theta_deg` rows (m, degrees); raises as `read_kitti` does."""
    table = np.array([row for _, row in _rows(path, 3, "planar trajectory")])
    return _untimed(path, _planar(table[:, 0], table[:, 1], np.deg2rad(table[:, 2])))


def read_g2o_vertices(path: str | Path) -> Trajectory:
    """Reads the VERTEX_SE2 or VERTEX_SE3:QUAT lines of a g2o file, in file order; raises as `read_kitti` does."""
    lines = [(number, line.split()) for number, line in data_lines(path)]
    rows = [(number, f[0], floats(path, number, f[2:])) for number, f in lines if f[0].startswith("VERTEX_SE")]
    if not rows:
        raise ValueError(f"{path}: no VERTEX_SE2 or VERTEX_SE3:QUAT line; give a pose graph with vertices")
    sizes = {"VERTEX_SE2": 3, "VERTEX_SE3:QUAT": 7}
    for number, tag, values in rows:
        if tag != rows[0][1] or len(values) != sizes.get(tag):
            raise ValueError(
                f"{path} line {number}: a {tag} line with {len(values)} numbers after the id; one kind a file"
            )
    table = np.array([values for _, _, values in rows])
    if rows[0][1] == "VERTEX_SE2":
        return _untimed(path, _planar(*table.T))
    rotation = _rotations(path, [number for number, _, _ in rows], table[:, [6, 3, 4, 5]])
    return _untimed(path, poses_from(rotation, table[:, :3]))


def read(path: str | Path) -> Trajectory:
    """Reads a trajectory, its layout recognised by its first row; a timestamp may occur twice.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: no known layout, or what the layout's reader raises; names file and line.
    """
    lines = data_lines(path)
    if not lines:
        raise ValueError(f"{path}: no poses; give a TUM, KITTI, `x y theta_deg` or g2o file")
    number, first = lines[0]
    if any(line.startswith(("VERTEX_SE", "EDGE_SE")) for _, line in lines):
        return read_g2o_vertices(path)
    columns = len(first.replace(",", " ").split())
    readers: dict[int, Callable[[str | Path], Trajectory]] = {
        3: read_planar,
        8: partial(read_tum, repeats=True),
        12: read_kitti,
    }
    if columns not in readers:
        raise ValueError(
            f"{path} line {number}: {columns} columns; a TUM row has 8, a KITTI row 12, an `x y theta_deg` row 3"
        )
    return readers[columns](path)


def write_tum(
    path: str | Path, timestamps: Float[np.ndarray, " N"], poses: Float[np.ndarray, "N 4 4"], comment: str = ""
) -> None:
    """Writes TUM rows, whole, to a nanometre and a nanosecond.

    Args:
      path: the file.
      timestamps: s.
      poses: fixed_from_moving, metres.
      comment: a line for the head of the file, such as which frame is meant.
    """
    quaternion = quaternion_from_rotation(poses[:, :3, :3])[:, [1, 2, 3, 0]]
    table = np.concatenate([timestamps[:, None], poses[:, :3, 3], quaternion], axis=1) + 0.0  # -0.0 becomes 0.0
    header = "timestamp tx ty tz qx qy qz qw"
    with whole_file(path) as file:
        np.savetxt(file, table, fmt=["%.9f"] * 4 + ["%.12f"] * 4, header=f"{comment}\n{header}" if comment else header)


def write_kitti(path: str | Path, poses: Float[np.ndarray, "N 4 4"]) -> None:
    """Writes KITTI rows, whole: the first three rows of each pose, row-major, metres."""
    with whole_file(path) as file:
        np.savetxt(file, poses[:, :3].reshape(-1, 12) + 0.0, fmt="%.12f")
