"""A table of numbers as fields: what separates the columns, decimal commas, quotes, comments, a first row of names.

Blanks, tabs, commas or semicolons separate. Fields stay text, with a point for the decimal comma: times lose no digit.
"""

import csv
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ebjax.io.text import lines_of, read_text

COMMENTS = ("#", "%", "//")
LOST_WORDS = frozenset(
    "nan -nan +nan nan(ind) -nan(ind) 1.#qnan 1.#ind -1.#ind 1.#inf -1.#inf inf -inf +inf infinity -infinity "
    "null none na n/a - --".split()
) | {""}
COLMAP = (
    "it is COLMAP's list of images: its poses map the world into the camera and have no times. Invert each, "
    "(R, t) -> (R^T, -R^T t), and write rows `timestamp tx ty tz qx qy qz qw`"
)
NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")
COMMA_NUMBER = re.compile(r"[+-]?[0-9]*,[0-9]+([eE][+-]?[0-9]+)?")
UNIT = re.compile(r"(?<!\s)\s*([\[(])([^\[\]()]*)([\])])")

Row = tuple[int, list[str]]
Split = Callable[[str], list[str]]


@dataclass(frozen=True)
class Table:
    """The rows of a file and what may name their columns.

    Attributes:
      path: of the file.
      rows: (line number, fields) of each; all have as many fields.
      trailing: how many empty columns stood behind these: trailing separators, or names without values.
      comments: (line number, text) of the comments before the first row.
      names: (line number, text) of the first row, where it is no numbers.
      notes: what the user should know of how the file was read.
    """

    path: str
    rows: list[Row]
    trailing: int = 0
    comments: tuple[tuple[int, str], ...] = ()
    names: tuple[int, str] | None = None
    notes: tuple[str, ...] = ()

    @property
    def width(self) -> int:
        """The number of columns."""
        return len(self.rows[0][1])


def read_table(path: str | Path) -> Table:
    """Reads the rows of a text file.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: no rows, or rows with different numbers of columns; names file and line.
    """
    comments: list[tuple[int, str]] = []
    lines: list[tuple[int, str]] = []
    names = None
    for number, line in enumerate(lines_of(read_text(path)), start=1):
        text = line.strip()
        if text.startswith(COMMENTS):
            if not lines:
                comments.append((number, text.lstrip("#%/").strip()))
        elif text and not lines and names is None and not holds_numbers(text):
            names = (number, line.strip(" \f\v"))
        elif text:
            # Tabs at the ends stand for empty fields.
            lines.append((number, re.sub(r"\s#.*", "", line.strip(" \f\v"))))
    if any("IMAGE_ID" in text and "CAMERA_ID" in text for _, text in comments):
        raise ValueError(f"{path}: {COLMAP}")
    if not lines:
        raise ValueError(f"{path}: no poses; give a TUM, KITTI, `x y theta_deg` or g2o file, one row a pose")
    first, text = lines[0]
    if not holds_numbers(text):
        raise ValueError(f"{path} line {first}: {text.strip()[:60]!r} is no row of numbers; give one row a pose")
    split, decimal = _separator([text for _, text in lines])
    rows = [(number, split(text)) for number, text in lines]
    if decimal:
        rows = [(n, [f.replace(",", ".") if COMMA_NUMBER.fullmatch(f) else f for f in fields]) for n, fields in rows]
    rows, trailing = _without_trailing(rows)
    width = len(rows[0][1])
    for number, fields in rows:
        if len(fields) != width:
            raise ValueError(
                f"{path} line {number}: {len(fields)} columns, but line {first} has {width}; correct or remove the line"
            )
    if _decimal_and_separating(rows):
        raise ValueError(
            f"{path} line {first}: commas are decimal and stand between the columns as well; separate the columns by "
            "blanks or semicolons"
        )
    notes = (f"{path}: commas are decimal, read as points",) if decimal else ()
    return Table(str(path), rows, trailing, tuple(comments), names, notes)


def holds_numbers(text: str) -> bool:
    """Whether a row holds numbers: at least one, and as many as words that are none."""
    fields = [field.strip("\"' ") for field in re.split(r"[\s;,]+", text)]
    numbers = sum(bool(NUMBER.fullmatch(field)) for field in fields)
    words = sum(not NUMBER.fullmatch(field) and field.lower() not in LOST_WORDS for field in fields)
    return numbers > 0 and numbers >= words


def name_rows(text: str) -> list[list[str]]:
    """Splits a line of column names in every way it may be meant; units stay with their names, `x [m]` as `x[m]`."""
    text = UNIT.sub(lambda m: m.group(1) + re.sub(r"[,;]", "|", re.sub(r"\s", "", m.group(2))) + m.group(3), text)
    ways = [*(text.strip(" ").split(separator) for separator in ";,\t"), re.split(r"[\s,;]+", text.strip(" "))]
    rows = [[name.strip().strip("\"' ") for name in names] for names in ways]
    return [row for k, row in enumerate(rows) if len(row) > 1 and row not in rows[:k]]


def _separator(lines: list[str]) -> tuple[Split, bool]:
    """Finds what separates the columns, and whether commas are decimal."""
    quoted = any('"' in line for line in lines)
    bare = [re.sub(r'"[^"]*"', "q", line) for line in lines] if quoted else lines
    points = any(re.search(r"\d\.\d", line) for line in lines)
    if any(";" in line for line in bare):
        return _by(";", quoted), not points and any("," in line for line in lines)
    if not points:
        for split in (_blanks, _commas_and_blanks):
            if _decimal([split(line) for line in bare]):
                return split, True
    if any("," in line for line in bare):
        # `1.0, 2.0 3.0`: either separates.
        both = any(re.search(r"\d\s+[-+.\d]", line) for line in bare) and not any(",," in line for line in bare)
        inside = [field for line in lines for field in re.findall(r'"([^"]*)"', line)] if quoted else []
        decimal = any(COMMA_NUMBER.fullmatch(field) for field in inside)
        return (_either, False) if both and not quoted else (_by(",", quoted), decimal)
    if any("\t" in line for line in bare) and len({len(line.split()) for line in bare}) > 1:
        return _by("\t", quoted), False
    return _blanks, False


def _blanks(line: str) -> list[str]:
    return [field.strip("\"'") for field in line.split()]


def _commas_and_blanks(line: str) -> list[str]:
    return [field.strip("\"'") for field in re.split(r",\s+", line.strip())]


def _either(line: str) -> list[str]:
    return line.replace(",", " ").split()


def _by(separator: str, quoted: bool) -> Split:
    if not quoted:
        return lambda line: [field.strip() for field in line.split(separator)]
    return lambda line: [field.strip() for field in _quoted(line, separator)]


def _quoted(line: str, separator: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    except csv.Error:  # a field of more than 128 kB, which is no number either way
        return line.split(separator)


def _decimal(rows: list[list[str]]) -> bool:
    """Whether the fields are numbers with at most one comma each, and some have one."""
    commas = [field for row in rows for field in row if "," in field]
    return bool(commas) and min(len(row) for row in rows) > 1 and all(COMMA_NUMBER.fullmatch(f) for f in commas)


def _decimal_and_separating(rows: list[Row]) -> bool:
    """Whether every second column looks like decimals: digits, as many in every row, some with leading zeros."""
    fields = [field for _, row in rows for field in row[1::2]]
    if len(rows[0][1]) % 2 or len({len(field) for field in fields}) != 1 or len(fields[0]) < 3:
        return False
    return all(field.isdigit() for field in fields) and any(field.startswith("0") for field in fields)


def _without_trailing(rows: list[Row]) -> tuple[list[Row], int]:
    """Leaves out the empty columns at the end, and counts them."""
    trailing = 0
    while len(rows[0][1]) > 1 and all(fields and not fields[-1] for _, fields in rows):
        rows, trailing = [(number, fields[:-1]) for number, fields in rows], trailing + 1
    return rows, trailing
