"""Fields as numbers: what is lost is NaN, what is no number is refused, and times are rounded once.

A stamp of nineteen digits does not fit a float64: its text is shifted to seconds before it becomes one.
"""

from decimal import Decimal

import numpy as np
from jaxtyping import Float

from ebjax.io.pose_table.fields import LOST_WORDS, NUMBER, Table
from ebjax.io.pose_table.layout import Layout

EXPONENT = {"s": 0, "ms": -3, "us": -6, "ns": -9}
UNIT_NAMES = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
# Of anything that a table of poses holds; nanoseconds since 1970 are the largest.
LARGEST = 1e25
MOST_S = 1e11
# From 2001 to 2100, in seconds since 1970: a clock that counts anything else is not set to the date.
EPOCH_S = (1e9, 4.1e9)
LONGEST_STEP_S, LONGEST_DATED_STEP_S = 1e4, 10.0
NANOSECONDS = 1e14
UNKNOWN_UNIT = (
    "stamps up to {:.6g}, {:.6g} apart (median), are no seconds, and their unit is not known; name it in the first "
    "line, such as `# timestamp_ns tx ty tz qx qy qz qw`, or timestamp_us, timestamp_ms, timestamp_s"
)


def columns_of(table: Table, columns: tuple[int, ...]) -> Float[np.ndarray, "N C"]:
    """Returns the numbers of some columns; NaN where a field is empty, not finite or says that there is none.

    Raises:
      ValueError: a field is not a number; names file and line.
    """
    values = np.empty((len(table.rows), len(columns)))
    for row, (number, fields) in zip(values, table.rows, strict=True):
        for k, column in enumerate(columns):
            row[k] = _number(table.path, number, fields[column])
    return values


def _number(path: str, line: int, field: str) -> float:
    if field.lower() in LOST_WORDS:
        return float("nan")
    if not (NUMBER.fullmatch(field) and abs(value := float(field)) < LARGEST):
        raise ValueError(f"{path} line {line}: {field[:60]!r} is not a number; correct or remove the line")
    return value


def seconds(table: Table, layout: Layout) -> tuple[Float[np.ndarray, " N"], tuple[str, ...]]:
    """Returns the times of the rows in seconds, NaN where there is none, and what was converted or is not known.

    Raises:
      ValueError: a field is not a number; names file and line.
    """
    values = columns_of(table, layout.time)
    if len(layout.time) == 2:
        whole, rest = layout.time
        times = values.sum(axis=1)
        for k in np.flatnonzero(np.isfinite(times)):
            fields = table.rows[k][1]
            times[k] = float(Decimal(fields[whole]) + Decimal(fields[rest]).scaleb(-9))
        return times, ()
    raw = values[:, 0]
    known = raw[np.isfinite(raw)]
    largest = np.abs(known).max(initial=0.0)
    step = float(np.median(np.abs(np.diff(known)))) if len(known) > 1 else 0.0
    unit, why = layout.time_unit, "header"
    if not unit or (unit == "s" and largest > MOST_S):
        unit, why = _unit_by_size(known, largest, step), "by their size"
    if unit == "s":
        strange = not layout.time_unit and (largest > MOST_S or step >= LONGEST_STEP_S)
        return raw, (f"{table.path}: {UNKNOWN_UNIT.format(largest, step)}",) * bool(strange)
    column = layout.time[0]
    times = raw.copy()
    for k in np.flatnonzero(np.isfinite(raw)):
        mantissa, _, exponent = table.rows[k][1][column].lower().partition("e")
        times[k] = float(f"{mantissa}e{int(exponent or 0) + EXPONENT[unit]}")
    return times, (f"{table.path}: stamps are {UNIT_NAMES[unit]} ({why}), read as seconds",)


def _unit_by_size(known: Float[np.ndarray, " N"], largest: float, step: float) -> str:
    """The unit of stamps that no header names: by the date, nanoseconds above 1e14, else seconds."""
    if largest > MOST_S:
        for unit in ("ms", "us"):
            scale = 10.0 ** EXPONENT[unit]
            dated = EPOCH_S[0] <= scale * known.min() and scale * largest <= EPOCH_S[1]
            if dated and scale * step <= LONGEST_DATED_STEP_S:
                return unit
    return "ns" if largest > NANOSECONDS else "s"
