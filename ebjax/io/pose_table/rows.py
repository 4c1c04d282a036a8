"""The rows of a table as poses, without those that hold none."""

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from ebjax.io.pose_table.counted import counted_layout
from ebjax.io.pose_table.fields import Table, read_table
from ebjax.io.pose_table.header import named_layout
from ebjax.io.pose_table.layout import Layout
from ebjax.io.pose_table.numbers import columns_of, seconds
from ebjax.io.pose_table.rotations import poses_of

SHOWN = 4


@dataclass(frozen=True)
class PoseRows:
    """Poses in a file's order.

    Attributes:
      path: of the file.
      numbers: of their lines.
      rows: of the poses among the file's rows, counted from 0.
      timestamps: s; None for a file without times.
      poses: fixed_from_moving, metres.
      notes: what was converted, guessed or left out, a line each.
    """

    path: str
    numbers: list[int]
    rows: list[int]
    timestamps: Float[np.ndarray, " N"] | None
    poses: Float[np.ndarray, "N 4 4"]
    notes: tuple[str, ...]


def read_pose_rows(path: str | Path) -> PoseRows:
    """Reads a table of poses: its columns by its header, or by their number.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: no poses, columns that are not known, what is no number or no rotation; names file and line.
    """
    table = read_table(path)
    layout = named_layout(table) or counted_layout(table)
    notes = list(table.notes) + [f"{path}: {sentence}" for sentence in layout.says]
    values = columns_of(table, layout.pose)
    times = None
    if layout.time:
        times, converted = seconds(table, layout)
        notes += converted
    held = _held(layout, values)
    notes += _left_out(table, held, times)
    if times is not None and not np.isfinite(times[held]).all():
        number, fields = table.rows[np.flatnonzero(held & ~np.isfinite(times))[0]]
        raise ValueError(
            f"{path} line {number}: {fields[layout.time[0]]!r} is not a finite time; correct or remove the line"
        )
    rows = [int(row) for row in np.flatnonzero(held)]
    numbers = [table.rows[row][0] for row in rows]
    poses, says = poses_of(str(path), numbers, layout, values[held])
    notes += [f"{path}: {sentence}" for sentence in says]
    return PoseRows(str(path), numbers, rows, None if times is None else times[held], poses, tuple(notes))


def _held(layout: Layout, values: Float[np.ndarray, "N C"]) -> Bool[np.ndarray, " N"]:
    """Which rows hold a pose: finite, and a quaternion or matrix that is not all zeros."""
    held = np.isfinite(values).all(axis=1)
    first = len(layout.position)
    if layout.quaternion or layout.matrix:
        held &= (np.abs(values[:, first : first + 4]) > 1e-9).any(axis=1)
    return held


def _left_out(table: Table, held: Bool[np.ndarray, " N"], times: Float[np.ndarray, " N"] | None) -> list[str]:
    lost = np.flatnonzero(~held)
    if not len(lost):
        return []
    if len(lost) == len(held):
        raise ValueError(f"{table.path}: none of its {len(held)} rows holds a pose; give the poses, not NaN or zeros")
    during = ""
    if times is not None and np.isfinite(times[lost]).all():
        during = f" ({times[lost].min():.3f} to {times[lost].max():.3f} s)"
    return [
        f"{table.path}: {len(lost)} of {len(held)} rows hold no pose (NaN, empty, or a null quaternion) and are left "
        f"out: {lines_listed([table.rows[k][0] for k in lost])}{during}"
    ]


def lines_listed(numbers: list[int]) -> str:
    """Lists line numbers, neighbours as a range: `lines 5-7, 20`."""
    ranges = []
    for _, run in itertools.groupby(enumerate(numbers), key=lambda pair: pair[1] - pair[0]):
        members = [number for _, number in run]
        ranges.append(f"{members[0]}-{members[-1]}" if len(members) > 1 else str(members[0]))
    more = f" and {len(ranges) - SHOWN} more places" if len(ranges) > SHOWN else ""
    return ("line " if len(numbers) == 1 else "lines ") + ", ".join(ranges[:SHOWN]) + more
