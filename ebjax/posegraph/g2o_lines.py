"""g2o text to vertices and edges as they stand in the file, every number checked. Errors name file and line."""

import gzip
import io
import re
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ebjax.posegraph.g2o_tags import EDGES, OFFSETS, PLANAR, SENSOR_DATA, SIZES, VERTICES, Edge, not_supported, plain

MOST_BYTES = 1 << 27
MOST = 1e100
"""Squares of larger numbers are infinite."""
_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")


class Vertex(NamedTuple):
    """A VERTEX line."""

    layout: str
    values: list[float]
    line: int


class Measured(NamedTuple):
    """An edge's line: its form, ids of vertices and of parameters (None: none is meant), measurement, information."""

    tag: str
    form: Edge
    ends: tuple[int, ...]
    parameters: tuple[int, ...] | None
    values: list[float]
    information: list[float]
    line: int


@dataclass
class Lines:
    """A file's content; `notes` say what was read otherwise than it stands there."""

    name: str
    vertices: dict[int, Vertex] = field(default_factory=dict)
    edges: list[Measured] = field(default_factory=list)
    offsets: dict[int, Vertex] = field(default_factory=dict)
    fixes: list[tuple[int, int]] = field(default_factory=list)
    equivalent: list[tuple[int, int, int]] = field(default_factory=list)
    planar: bool = True
    notes: list[str] = field(default_factory=list)


def read_text(path: Path) -> str:
    """The file as text, unpacked if it is gzip.

    Raises:
      ValueError: damaged gzip, or not text.
    """
    content = path.read_bytes()
    try:
        if content[:2] == b"\x1f\x8b":
            with gzip.GzipFile(fileobj=io.BytesIO(content)) as file:
                content = file.read(MOST_BYTES)
            if len(content) == MOST_BYTES:
                raise ValueError(f"{path}: unpacks to more than {MOST_BYTES >> 20} MB; unpack it first")
        text = content.decode("utf-8-sig")
    except (EOFError, zlib.error, gzip.BadGzipFile):
        raise ValueError(f"{path}: damaged gzip file; copy it again") from None
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise ValueError(f"{path}: not a text file; give a g2o file (or a .gz of one)")
    return text


def parse_lines(text: str, name: str) -> Lines:
    """Reads every line.

    Raises:
      ValueError: a line that cannot be read, or means what is not supported; says what to do about it.
    """
    found, seen = Lines(name), ""
    skipped: dict[str, list[int]] = {}
    number = _decimal_commas(text, found) if "," in text else float
    for line, row in enumerate(text.removeprefix("\ufeff").splitlines(), 1):
        tokens = row.partition("#")[0].split()
        if not tokens:
            continue
        tag = plain(tokens[0])
        where = f"{name}:{line}"
        form = EDGES.get(tag)
        layout = form.layout if form else VERTICES.get(tag)
        if layout:
            if seen and (layout in PLANAR) != found.planar:
                raise ValueError(f"{where}: {tokens[0]} in a graph of {seen}; keep one of SE2 and SE3 per file")
            seen, found.planar = seen or tokens[0], layout in PLANAR
        if form:
            found.edges.append(_edge(tokens, tag, form, line, where, number))
        elif layout:
            vertex, id_ = _values(tokens, layout, line, where, number)
            if found.vertices.setdefault(id_, vertex) is not vertex:
                raise ValueError(f"{where}: vertex {id_} appears twice; delete one of the two lines")
        elif tag == "FIX":
            found.fixes += [(_id(t, where, "FIX takes vertex ids"), line) for t in tokens[1:]]
        elif tag in OFFSETS:
            vertex, id_ = _values(tokens, OFFSETS[tag], line, where, number)
            found.offsets[id_] = vertex
        elif tag == "EQUIV":
            if len(tokens) != 3:
                raise ValueError(f"{where}: EQUIV takes two vertex ids; correct the line")
            a, b = (_id(t, where, "EQUIV takes vertex ids") for t in tokens[1:])
            found.equivalent.append((a, b, line))
        elif tag in SENSOR_DATA:
            skipped.setdefault(tag, []).append(line)
        elif not tag.startswith("PARAMS_"):
            raise ValueError(f"{where}: {not_supported(tokens[0][:40])}")
    if not seen:
        raise ValueError(f"{name}: holds no vertices and no edges; give a g2o file")
    for tag, lines in skipped.items():
        found.notes.append(f"{len(lines)} lines {tag}, from line {lines[0]}, are sensor data, no constraints; left out")
    return found


def _values(tokens, layout, line, where, number):
    """A line `tag id numbers` of a vertex or of parameters, and its id."""
    size = SIZES[layout][0]
    if len(tokens) != 2 + size:
        raise ValueError(
            f"{where}: {tokens[0]} has {len(tokens) - 1} numbers, needs {1 + size}; restore the line or delete it"
        )
    id_, values = _id(tokens[1], where, f"{tokens[0]} begins with an id"), _numbers(tokens, tokens[2:], where, number)
    if not np.all(np.abs(values) < MOST):
        raise ValueError(f"{where}: {tokens[0]} {id_} is not finite, or larger than {MOST:g}; correct the line")
    if layout == "quat" and np.linalg.norm(values[3:]) < 1e-3:
        raise ValueError(f"{where}: vertex {id_} has a zero quaternion; correct the line")
    return Vertex(layout, values, line), id_


def _edge(tokens, tag, form, line, where, number):
    size, entries = SIZES[form.layout]
    most = form.ends + form.parameters
    head = len(tokens) - 1 - size - entries
    if not most - form.parameters * form.optional <= head <= most:
        raise ValueError(
            f"{where}: {tokens[0]} has {len(tokens) - 1} numbers, needs {most + size + entries}; "
            "restore the line or delete it"
        )
    ids = [_id(t, where, f"{tokens[0]} begins with ids") for t in tokens[1 : 1 + head]]
    values = _numbers(tokens, tokens[1 + head :], where, number)
    ends = tuple(ids[: form.ends])
    if not np.all(np.abs(values) < MOST):
        raise ValueError(f"{where}: edge holds a number that is not finite, or larger than {MOST:g}; correct the line")
    if form.layout == "quat" and np.linalg.norm(values[3:7]) < 1e-3:
        raise ValueError(f"{where}: quaternion is zero; correct the line")
    if form.ends == 2 and ends[0] == ends[1]:
        raise ValueError(f"{where}: edge joins vertex {ends[0]} with itself; delete the line")
    parameters = tuple(ids[form.ends :]) if head > form.ends else None
    return Measured(tag, form, ends, parameters, values[:size], values[size:], line)


def _id(token, where, lack):
    try:
        id_ = int(token)
    except ValueError:
        raise ValueError(f"{where}: {lack}, and {token} is none; correct the line") from None
    if not -(2**63) <= id_ < 2**63:
        raise ValueError(f"{where}: {id_} does not fit into 64 bits; renumber the vertices")
    return id_


def _numbers(tokens, fields, where, number):
    try:
        return [number(t) for t in fields]
    except ValueError:
        mixed = number is _with_commas and any("." in t for t in fields)
        lack = "decimal points in a file with decimal commas" if mixed else "something that is not a number"
        raise ValueError(f"{where}: {tokens[0]} holds {lack}; correct the line") from None


def _decimal_commas(text: str, found: Lines) -> Callable[[str], float]:
    """The reader of numbers for a text with commas in it: of decimal commas, if they are that."""
    for line, row in enumerate(text.splitlines(), 1):
        tokens = row.partition("#")[0].split()
        first = next((t for t in tokens[1:] if "," in t), None)
        if first is None and (not tokens or "," not in tokens[0]):
            continue
        if first is None or not _COMMA.fullmatch(first):
            raise ValueError(f"{found.name}:{line}: commas between fields; separate them by spaces")
        found.notes.append(f"decimal commas are read as points, as in {first} in line {line}")
        return _with_commas
    return float


def _with_commas(token):
    return float(token.replace(".", "?").replace(",", "."))
