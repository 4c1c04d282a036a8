"""The columns of a pose by their names: which of a header's names are the time, the position and the orientation."""

import itertools

from ebjax.io.pose_table.fields import Table, name_rows
from ebjax.io.pose_table.layout import Layout
from ebjax.io.pose_table.names import CLOCK, UNITS, Name, meaning

EXAMPLE = "`# timestamp tx ty tz qx qy qz qw`"
REMEDY = f"name the columns in the first line, such as {EXAMPLE}, every other column by any other name"
YAWS = ("yaw", "theta", "heading", "psi", "th")
SHOWN = 4
LONGEST = 40
"""Characters of a name that a message shows."""


class IncompleteError(ValueError):
    """Names that are no pose, or more than one."""


def named_layout(table: Table) -> Layout | None:
    """Finds the line that names the columns: the first row, or a comment before it.

    Returns:
      The columns; None where no line names them.

    Raises:
      ValueError: a line names columns, but not a pose, more than one, or another number of columns than the rows have.
    """
    if table.names is not None:
        number, text = table.names
        faults = []
        for names in name_rows(text):
            if 0 <= len(names) - table.width <= table.trailing:
                try:
                    return layout_of(names[: table.width])
                except IncompleteError as error:
                    faults.append(str(error))
        fault = faults[0] if faults else f"{text[:80]!r} does not name the {table.width} columns of the rows"
        raise ValueError(f"{table.path} line {number}: {fault}; {REMEDY}")
    refused = None
    for number, text in reversed(table.comments):
        for names in name_rows(text):
            try:
                if layout := _of_comment(table, names):
                    return layout
            except IncompleteError as error:
                refused = refused or ValueError(
                    f"{table.path} line {number}: {error}; correct this line, or remove it if the columns have one of "
                    "the usual orders"
                )
    if refused:
        raise refused
    return None


def _of_comment(table: Table, names: list[str]) -> Layout | None:
    """The columns that a comment names; None for a comment that is about something else."""
    known = sum(meaning(name).kind != "other" for name in names)
    if len(names) == table.width:
        return layout_of(names) if known >= 3 else None
    if len(names) > table.width and all(meaning(name).kind == "other" for name in names[table.width :]):
        # A remark may follow the names.
        names = names[: table.width]
    try:
        layout = layout_of(names)
    except IncompleteError:
        return None
    if len(names) != table.width:
        raise IncompleteError(f"{len(names)} columns are named, but the rows have {table.width}")
    return layout


def layout_of(texts: list[str]) -> Layout:
    """Finds a pose and its time among the names of all columns.

    Raises:
      IncompleteError: there is no position or no orientation, two that are as good, or a unit that is not known.
    """
    names = [meaning(text) for text in texts]
    time, time_unit = _time(names)
    position, quaternion = _axes(names)
    if not position:
        raise IncompleteError(f"no column is named as the position (x, y or x, y, z); the names are {_listed(texts)}")
    angles = () if quaternion else _angles(names)
    if not quaternion and not angles:
        raise IncompleteError(
            "no columns are named as the orientation (qx, qy, qz, qw; roll, pitch, yaw; or yaw); the names are "
            f"{_listed(texts)}"
        )
    position_unit = _one_unit("position", [names[k] for k in position]) or "m"
    angle_unit = _one_unit("angle", [names[k] for k in angles])
    says = []
    if quaternion and quaternion[0] < min(quaternion[1:]):
        says.append("its quaternions are written qw qx qy qz (header)")
    used = {*time, *position, *quaternion, *angles}
    left = [text for k, text in enumerate(texts) if k not in used]
    if left:
        says.append(f"columns that are no part of a pose are left out: {_listed(left)}")
    return Layout(time, position, quaternion, angles, (), time_unit, position_unit, angle_unit, True, tuple(says))


def _listed(texts: list[str]) -> str:
    more = f" and {len(texts) - SHOWN} more" if len(texts) > SHOWN else ""
    return ", ".join(text[:LONGEST] or "(no name)" for text in texts[:SHOWN]) + more


def _one_unit(kind: str, names: list[Name]) -> str:
    units = {name.unit for name in names}
    for unit in sorted(units - {""}):
        if unit not in UNITS[kind]:
            raise IncompleteError(f"unit {unit!r} is not known; convert the column to one of {', '.join(UNITS[kind])}")
    if len(units) > 1:
        raise IncompleteError(f"{', '.join(name.text for name in names)} are named in different units")
    return units.pop() if units else ""


def _time(names: list[Name]) -> tuple[tuple[int, ...], str]:
    """The time's columns and unit: a message's own stamp before any other, a pair of columns before one."""
    times = [(k, name) for k, name in enumerate(names) if name.kind == "time"]
    pairs = [
        ((k, j), name)
        for (k, name), (j, other) in itertools.product(times, times)
        if (name.part, other.part) == ("s", "ns") and name.group == other.group
    ]
    paired = {k for pair, _ in pairs for k in pair}
    found = pairs + [((k,), name) for k, name in times if k not in paired]
    if not found:
        return (), ""

    def rank(columns: tuple[int, ...], name: Name) -> int:
        own = name.group.split()
        return ("header" not in own) * 4 + (len(columns) == 1) * 2 + (not CLOCK | {"header"} >= set(own))

    least = min(rank(*item) for item in found)
    best = [item for item in found if rank(*item) == least]
    _only_one("time", [name.text for _, name in best])
    columns, name = best[0]
    return columns, "s" if len(columns) == 2 else _one_unit("time", [name])


def _only_one(what: str, texts: list[str]) -> None:
    if len(texts) > 1:
        raise IncompleteError(f"{' and '.join(texts[:2])} may both be the {what}; rename the one that is not")


def _axes(names: list[Name]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """The columns of the position and of the quaternion (wxyz): complete groups, those that say what they are first."""
    groups: list[tuple[str, str, dict[str, int]]] = []
    latest: dict[tuple[str, str], dict[str, int]] = {}
    for k, name in enumerate(names):
        if name.kind not in ("position", "quaternion", "axis"):
            continue
        key = name.kind, name.group
        # x, y, z, x, y, z, w are a position and a quaternion.
        if key not in latest or name.part in latest[key]:
            latest[key] = {}
            groups.append((*key, latest[key]))
        latest[key][name.part] = k
    found: dict[str, list[tuple[int, tuple[int, ...]]]] = {"position": [], "quaternion": []}
    for kind, group, columns in groups:
        rank = 0 if kind != "axis" else 1 if not group else 2
        if set(columns) == set("xyzw") and kind != "position":
            found["quaternion"].append((rank, tuple(columns[axis] for axis in "wxyz")))
        elif set(columns) in (set("xyz"), set("xy")) and kind != "quaternion":
            found["position"].append((rank, tuple(columns[axis] for axis in sorted(columns))))
    chosen: dict[str, tuple[int, ...]] = {}
    for what, candidates in found.items():
        least = min((rank for rank, _ in candidates), default=0)
        best = [columns for rank, columns in candidates if rank == least]
        _only_one(what, [names[columns[-1]].text for columns in best])
        chosen[what] = best[0] if best else ()
    return chosen["position"], chosen["quaternion"]


def _angles(names: list[Name]) -> tuple[int, ...]:
    """The columns of roll, pitch and yaw, or of yaw alone."""
    groups: dict[str, dict[str, int]] = {}
    for k, name in enumerate(names):
        if name.kind == "angle":
            if name.part in groups.setdefault(name.group, {}):
                _only_one("orientation", [names[groups[name.group][name.part]].text, name.text])
            groups[name.group][name.part] = k
    found = []
    for parts in groups.values():
        for spelt in (("roll", "pitch", "yaw"), ("phi", "theta", "psi"), ("roll", "pitch", "heading")):
            if set(spelt) <= parts.keys():
                found.append(tuple(parts[part] for part in spelt))
                break
        else:
            if len(parts) == 1 and (part := next(iter(parts))) in (*YAWS, "phi"):
                found.append((parts[part],))
    _only_one("orientation", [names[columns[-1]].text for columns in found])
    return found[0] if found else ()
