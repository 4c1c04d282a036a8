"""The columns of a pose where no line names them: by their number, and by a check where that says too little."""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from ebjax.io.pose_table.fields import LOST_WORDS, NUMBER, Table
from ebjax.io.pose_table.header import REMEDY
from ebjax.io.pose_table.layout import Layout
from ebjax.io.pose_table.numbers import columns_of

KNOWN = (
    "known without a header are 3 columns (`x y theta_deg`), 4 (`t x y theta`), 7 (`x y z qx qy qz qw`), "
    "8 (TUM), 9 (TUM with an id or a number), 11 (VINS), 12 (KITTI), 13 (KITTI with a number or time), 16 (4x4), "
    "17 (EuRoC, or 4x4 with a number or time)"
)
SHARE = 0.9


def _tum(time: int, first: int) -> Layout:
    """Time, then x y z qx qy qz qw from column `first` on."""
    x = first
    return Layout((time,), (x, x + 1, x + 2), (x + 6, x + 3, x + 4, x + 5))


def counted_layout(table: Table) -> Layout:
    """Recognises the columns of a table without a header.

    Raises:
      ValueError: a number of columns that is not known, or two layouts fit, or none; says how to name the columns.
    """
    if layout := _echoed(table):
        return layout
    word = next((f for f in table.rows[0][1] if not NUMBER.fullmatch(f) and f.lower() not in LOST_WORDS), None)
    if word is not None:
        raise ValueError(
            f"{_place(table)}: {word[:60]!r} is not a number, and no line names the columns; {REMEDY}. "
            "Rows `name qw qx qy qz tx ty tz` of COLMAP and hloc map the world into the camera: invert those"
        )
    values = columns_of(table, tuple(range(table.width)))
    values = values[np.isfinite(values).all(axis=1)]
    if table.width not in BY_WIDTH:
        raise ValueError(f"{_place(table)}: {table.width} columns; {KNOWN}; or {REMEDY}")
    return BY_WIDTH[table.width](table, values)


def _place(table: Table) -> str:
    return f"{table.path} line {table.rows[0][0]}"


def _unit_length(quaternion: Float[np.ndarray, "N 4"]) -> bool:
    """Whether nearly all are unit quaternions; null ones, which stand for lost tracking, do not count."""
    length = np.linalg.norm(quaternion, axis=1)
    length = length[length > 1e-9]
    return len(length) > 0 and bool((np.abs(length - 1) < 0.05).mean() >= SHARE)


def _whole(values: Float[np.ndarray, " N"]) -> bool:
    return bool((values == np.round(values)).all()) and bool(np.abs(values).max(initial=0) < 1e11)


def _increasing(values: Float[np.ndarray, " N"]) -> bool:
    return bool((np.diff(values) >= 0).all())


def _three(table: Table, values: np.ndarray) -> Layout:
    return Layout(position=(0, 1), angles=(2,))


def _four(table: Table, values: np.ndarray) -> Layout:
    if not _increasing(values[:, 0]):
        raise ValueError(
            f"{_place(table)}: 4 columns, and the first is no time, as it does not increase; sort the file by time, or "
            f"{REMEDY}"
        )
    return Layout((0,), (1, 2), angles=(3,))


def _seven(table: Table, values: np.ndarray) -> Layout:
    if not _unit_length(values[:, 3:]):
        raise ValueError(
            f"{_place(table)}: 7 columns, and the last four are no unit quaternion; {REMEDY}, or "
            "`# timestamp x y z roll pitch yaw`"
        )
    return Layout(position=(0, 1, 2), quaternion=(6, 3, 4, 5))


def _eight(table: Table, values: np.ndarray) -> Layout:
    if len(values) and not _unit_length(values[:, 4:]) and _unit_length(values[:, 1:5]):
        raise ValueError(f"{_place(table)}: the quaternion stands before the position, not behind it; {REMEDY}")
    return _tum(0, 1)


def _nine(table: Table, values: np.ndarray) -> Layout:
    behind = _unit_length(values[:, 4:8]) and _increasing(values[:, 0]) and _whole(values[:, 8])
    before = _unit_length(values[:, 5:9]) and _increasing(values[:, 1]) and _whole(values[:, 0])
    if behind == before:
        fits = "fit" if behind else "do not fit"
        raise ValueError(
            f"{_place(table)}: 9 columns, and both `timestamp tx ty tz qx qy qz qw id` and "
            f"`number timestamp tx ty tz qx qy qz qw` {fits}; {REMEDY}"
        )
    layout, column = (_tum(0, 1), "last, an id,") if behind else (_tum(1, 2), "first, a number,")
    return _saying(layout, f"9 columns: the {column} is left out")


def _matrix(table: Table, values: np.ndarray) -> Layout:
    """A matrix, with a time or a number before it."""
    first = table.width % 4
    matrix = tuple(range(first, table.width))
    if not first:
        return Layout(matrix=matrix)
    if _whole(values[:, 0]):
        return _saying(Layout(matrix=matrix), f"{table.width} columns: the first, whole numbers, is no time; left out")
    return _saying(Layout((0,), matrix=matrix), f"{table.width} columns: the first is read as the time")


def _seventeen(table: Table, values: np.ndarray) -> Layout:
    if len(values) and (np.abs(values[:, 13:] - [[0.0, 0.0, 0.0, 1.0]]) < 1e-9).all():
        return _matrix(table, values)
    return _with_velocity(table, values)


def _with_velocity(table: Table, values: np.ndarray) -> Layout:
    """Time, position, quaternion w first, velocity and, in EuRoC's files, the biases."""
    whose = {11: "VINS'", 17: "EuRoC's"}[table.width]
    if not (_unit_length(values[:, 4:8]) and _increasing(values[:, 0])):
        raise ValueError(
            f"{_place(table)}: {table.width} columns, but not {whose}: time, position, unit quaternion, velocity; "
            + REMEDY
        )
    return Layout(
        (0,), (1, 2, 3), (4, 5, 6, 7), says=(f"{table.width} columns: {whose}, quaternions written qw qx qy qz",)
    )


def _echoed(table: Table) -> Layout | None:
    """The rows of `ros2 topic echo --csv`: seconds, nanoseconds, names of frames, then the pose."""
    fields = table.rows[0][1]
    words = next((k for k, field in enumerate(fields[2:]) if NUMBER.fullmatch(field)), 0)
    if words not in (1, 2) or not all(field.isdigit() for field in fields[:2]) or table.width < 2 + words + 7:
        return None
    x = 2 + words
    says = f"{table.width} columns: as ros2 topic echo --csv writes them, seconds, nanoseconds and frames first"
    return Layout((0, 1), (x, x + 1, x + 2), (x + 6, x + 3, x + 4, x + 5), named=True, says=(says,))


def _saying(layout: Layout, sentence: str) -> Layout:
    return dataclasses.replace(layout, says=(sentence,))


BY_WIDTH: dict[int, Callable[[Table, np.ndarray], Layout]] = {
    **{3: _three, 4: _four, 7: _seven, 8: _eight, 9: _nine, 11: _with_velocity, 17: _seventeen},
    **dict.fromkeys((12, 13, 16), _matrix),
}
