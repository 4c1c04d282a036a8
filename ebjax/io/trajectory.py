"""Trajectories in files: tables of poses (TUM, KITTI, EuRoC, RTAB-Map, any with a header) and vertices of pose graphs.

TUM: `timestamp tx ty tz qx qy qz qw`, `#` comments. KITTI: the first three rows of the 4x4 pose, row-major, no times.
Every reader takes .gz. A pose maps the moving frame into the fixed one, metres.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from ebjax.io.atomic import whole_file
from ebjax.io.g2o_vertices import is_pose_graph, read_vertices
from ebjax.io.pose_table.rows import PoseRows, lines_listed, read_pose_rows
from ebjax.io.poses import quaternion_from_rotation
from ebjax.io.text import data_lines


@dataclass(frozen=True)
class Trajectory:
    """Poses in time order.

    Attributes:
      timestamps: s; where the file has no times its rows' numbers from 0, without those of rows left out.
      poses: fixed_from_moving, metres.
      path: the file they came from.
      timed: whether the file has times.
      notes: what was converted, guessed or left out while reading, a line each that names the file.
    """

    timestamps: Float[np.ndarray, " N"]
    poses: Float[np.ndarray, "N 4 4"]
    path: str
    timed: bool = True
    notes: tuple[str, ...] = ()


def read(path: str | Path) -> Trajectory:
    """Reads a trajectory: columns by the file's header, or by their number; a stamp may occur twice, see `read_tum`.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: columns that are not known, what is no number or no rotation, no poses, unsorted times; names file,
        line and remedy.
    """
    if is_pose_graph(data_lines(path)):
        poses, notes = read_vertices(path)
        return Trajectory(np.arange(len(poses), dtype=np.float64), poses, str(path), False, notes)
    rows = read_pose_rows(path)
    if rows.timestamps is None:
        return Trajectory(np.array(rows.rows, np.float64), rows.poses, str(path), False, rows.notes)
    return _in_time(rows, repeats=True)


def read_tum(path: str | Path, *, repeats: bool = False) -> Trajectory:
    """Reads a trajectory that has times, in any layout that `read` knows.

    A row that repeats the stamp and the pose of the row before is left out. Another pose at the same stamp is refused,
    unless it is as near as the neighbours in time: then stamps were rounded, as in some motion-capture files.

    Args:
      path: the file.
      repeats: whether a near pose at the same stamp stays; else it is left out.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: as `read`, and a file without times.
    """
    if not is_pose_graph(data_lines(path)):
        rows = read_pose_rows(path)
        if rows.timestamps is not None:
            return _in_time(rows, repeats=repeats)
    raise ValueError(f"{path}: it has no times; give rows `timestamp tx ty tz qx qy qz qw`")


def _in_time(rows: PoseRows, *, repeats: bool) -> Trajectory:
    """Checks the order of the times, and leaves out what is there twice."""
    stamps, poses, numbers, notes = rows.timestamps, rows.poses, np.array(rows.numbers), list(rows.notes)
    assert stamps is not None
    earlier = np.flatnonzero(np.diff(stamps) < 0)
    if earlier.size:
        k = earlier[0]
        raise ValueError(
            f"{rows.path} line {numbers[k + 1]}: timestamp {stamps[k + 1]:.6f} is earlier than {stamps[k]:.6f} in line "
            f"{numbers[k]}; sort the file by time"
        )
    again = np.append(False, np.diff(stamps) == 0)
    same = again & np.append(False, (np.abs(np.diff(poses, axis=0)) < 1e-9).all(axis=(1, 2)))
    if same.any():
        where = lines_listed(numbers[same].tolist())
        notes.append(f"{rows.path}: {same.sum()} rows repeat the row before, time and pose, and are left out: {where}")
    kept = ~same
    other = _other_poses(rows.path, stamps[kept], poses[kept], numbers[kept])
    if other.any():
        where, fate = lines_listed(numbers[kept][other].tolist()), "kept" if repeats else "left out"
        notes.append(f"{rows.path}: the time of the row before, and a pose near it: {where} ({fate})")
        kept[np.flatnonzero(kept)[other]] = repeats
    return Trajectory(stamps[kept], poses[kept], rows.path, True, tuple(notes))


def _other_poses(
    path: str, stamps: Float[np.ndarray, " N"], poses: Float[np.ndarray, "N 4 4"], numbers: np.ndarray
) -> Bool[np.ndarray, " N"]:
    """Which rows have the stamp of the row before and another pose, as near as rows of other times are."""
    again = np.append(False, np.diff(stamps) == 0)
    far = np.zeros(len(stamps), bool)
    for part in (poses[:, :3, 3], poses[:, :3, :3].reshape(-1, 9)):
        step = np.append(0.0, np.linalg.norm(np.diff(part, axis=0), axis=1))
        # Steps into and out of such a row are left out of what is usual.
        usual = step[1:][~(again[1:] | again[:-1])]
        far |= again & (step > 2 * (np.quantile(usual, 0.99) if len(usual) else 0.0) + 1e-9)
    far = np.flatnonzero(far)
    if far.size:
        k = far[0]
        raise ValueError(
            f"{path} line {numbers[k]}: another pose at timestamp {stamps[k]:.6f}, which is also line "
            f"{numbers[k - 1]}'s; remove one of the two"
        )
    return again


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
