"""A list of images with their times: rgb.txt and depth.txt of TUM, the pairs of associate.py, data.csv of EuRoC."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ebjax.io import image_kinds
from ebjax.io.clocks import unix_unit
from ebjax.io.image_folder import SUFFIXES
from ebjax.io.text import check_increasing, floats, lines_of, read_text

EXPONENTS = {"seconds": 0, "milliseconds": -3, "microseconds": -6, "nanoseconds": -9}
UNITS = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
MOST_S = 1e14
"""Larger times are no seconds of any clock."""
UNIT = re.compile(r"(?:time|stamp)\w*?[\s_]*[\[(_]\s*(s|sec|ms|msec|us|usec|ns|nsec)\b\s*[\])]?", re.IGNORECASE)
ENDINGS = "|".join(sorted(suffix.lstrip(".") for suffix in {*SUFFIXES, *image_kinds.SUFFIXES, "npy", "gif"}))
NUMBER = r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?"
PAIR = re.compile(
    rf"({NUMBER})[\s,;]+(.+?\.(?:{ENDINGS}))[\"']?[\s,;]+({NUMBER})[\s,;]+(.+\.(?:{ENDINGS}))[\"']?", re.IGNORECASE
)
SINGLE = re.compile(r"([^\s,;]+)[\s,;]+(.+)")
DECIMAL_COMMA = re.compile(r"(\d+),(\d+)(?=[\s;])")
FORM, PAIR_FORM = "`timestamp file`", "`timestamp file timestamp file`"


@dataclass(frozen=True)
class ImageList:
    """What a list says.

    Attributes:
      path: of the list.
      names: of the files, as they are written.
      timestamps: s.
      beside: the second image of each line, of an association; None of a plain list.
      notes: what the user should know of how it was read, a line each.
    """

    path: Path
    names: tuple[str, ...]
    timestamps: Float[np.ndarray, " N"]
    beside: "ImageList | None" = None
    notes: tuple[str, ...] = ()


def read_image_list(path: Path) -> ImageList:
    """Reads lines of a time and a file, or of two of both, separated by blanks, commas or semicolons.

    Times in other units than seconds are converted: the first line names the unit, or the times are those of a date.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: a line of another form, unsorted or repeated times; names file and line.
    """
    header, lines = _split(path)
    notes: tuple[str, ...] = ()
    if lines and all(DECIMAL_COMMA.match(line) for _, line in lines):
        lines = [(number, DECIMAL_COMMA.sub(r"\1.\2", line)) for number, line in lines]
        notes += (f"{path}: the commas in its times are decimal points",)
    form, shape = (PAIR_FORM, PAIR) if lines and PAIR.fullmatch(lines[0][1]) else (FORM, SINGLE)
    rows = []
    for number, line in lines:
        if (match := shape.fullmatch(line)) is None:
            raise ValueError(f"{path} line {number}: {line[:80]!r} is not {form}; correct or remove the line")
        rows.append((number, match))
    first, *second = (
        _listed(path, header, [(number, match[k], match[k + 1]) for number, match in rows])
        for k in range(1, shape.groups, 2)
    )
    return replace(first, beside=second[0] if second else None, notes=(*notes, *first.notes))


def _split(path: Path) -> tuple[str, list[tuple[int, str]]]:
    """The comments and a first row of names, as one text, and the numbered lines of data."""
    header: str = ""
    lines: list[tuple[int, str]] = []
    for number, line in enumerate(lines_of(read_text(path)), start=1):
        text = line.strip()
        if text.startswith("#") or (
            text and not lines and re.match(r"[\"']?[a-z]*_?(time|stamp)", text, re.IGNORECASE)
        ):
            header += f"{text}\n"
        elif text:
            lines.append((number, text))
    return header, lines


def _listed(path: Path, header: str, rows: Sequence[tuple[int, str, str]]) -> ImageList:
    texts = [text.strip("\"'") for _, text, _ in rows]
    numbers = [floats(path, number, [text])[0] for (number, _, _), text in zip(rows, texts, strict=True)]
    unit, why = _unit(header, np.array(numbers))
    if unit != "seconds":
        # A stamp of nineteen digits does not fit a float64 before it is in seconds.
        numbers = [float(Decimal(text).scaleb(EXPONENTS[unit])) for text in texts]
    check_increasing(path, [(number, stamp) for (number, _, _), stamp in zip(rows, numbers, strict=True)])
    notes = () if unit == "seconds" else (f"{path}: stamps are {unit} ({why}), read as seconds",)
    names = tuple(name.strip().strip("\"'") for _, _, name in rows)
    return ImageList(path, names, np.array(numbers, dtype=np.float64), notes=notes)


def _unit(header: str, times: Float[np.ndarray, " N"]) -> tuple[str, str]:
    """The unit of the times, and what says so."""
    if named := UNIT.search(header):
        return UNITS[named[1].lower().removesuffix("ec")], "as its header says"
    unit = unix_unit(times) if len(times) else None
    if unit is None and len(times) and times[0] > MOST_S:
        unit = "nanoseconds"
    return unit or "seconds", "by their size"
