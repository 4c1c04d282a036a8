"""Reads one variable of MATLAB's files of version 5 (level 5, R2006b's default) as plain values.

A file is 128 bytes of header, then elements: type and size in 4 bytes each, content, padding to 8 bytes; one of at most
4 bytes has type and size in 2 bytes each. SciPy's reader is not used: a damaged file ends its process.
"""

import itertools
import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Element types that hold numbers."""
CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
"""Classes of numeric arrays; their elements may be of a smaller type."""
MATRIX, PACKED = 14, 15
CELL, STRUCT = 1, 2
COMPLEX = 0x0800
HEADER = 128
MOST_DEPTH = 50


class Element(NamedTuple):
    """An element's type and content."""

    kind: int
    content: memoryview


class Cells(NamedTuple):
    """A cell array in MATLAB's order: column by column."""

    parts: tuple[Any, ...]


class Structs(NamedTuple):
    """An array of structs in MATLAB's order: fields by name."""

    parts: tuple[dict[str, Any], ...]


def elements(content: memoryview, order: str) -> Iterator[Element]:
    """The elements of a content, one after the other.

    Raises:
      ValueError: one reaches beyond the end.
    """
    position = 0
    while position + 8 <= len(content):
        kind, size = struct.unpack_from(f"{order}2I", content, position)
        start = position + 8
        if kind >> 16:  # a small one
            kind, size, start = kind & 0xFFFF, kind >> 16, position + 4
        end = start + size
        if end > len(content) or (start == position + 4 and size > 4):
            raise ValueError("an element reaches beyond its end")
        yield Element(kind, content[start:end])
        position = end if kind == PACKED else position + 8 if start == position + 4 else end + -end % 8


def read_variable(path: str | Path, name: str) -> Any:
    """A variable: an array of numbers in MATLAB's shape, `Cells` or `Structs`; None for every other class.

    Raises:
      ValueError: no such variable, or a damaged file.
    """
    content = memoryview(Path(path).read_bytes())
    order = {b"IM": "<", b"MI": ">"}.get(bytes(content[126:128]))
    if order is None:
        raise ValueError("its header names no byte order")
    for element in elements(content[HEADER:], order):
        if element.kind == PACKED:
            element = _unpacked(element.content, order)
        if element.kind == MATRIX and len(element.content):
            found, value = _matrix(element.content, order, wanted=name)
            if found == name:
                return value
    raise ValueError(f"it has no variable {name!r}")


def _unpacked(content: memoryview, order: str) -> Element:
    """A compressed element, which says its size itself."""
    unpacker = zlib.decompressobj()
    head = unpacker.decompress(content, 8)
    if len(head) < 8:
        raise ValueError("a compressed element ends early")
    kind, size = struct.unpack(f"{order}2I", head)
    body = unpacker.decompress(unpacker.unconsumed_tail, size) if size else b""
    if len(body) < size:
        raise ValueError("a compressed element ends early")
    return Element(kind, memoryview(body))


def _matrix(content: memoryview, order: str, wanted: str | None = None, depth: int = 0) -> tuple[str, Any]:
    """Name and value of a matrix; the value is None where another name is wanted."""
    parts = elements(content, order)
    try:
        flags, sides, name = (next(parts) for _ in range(3))
    except (StopIteration, RuntimeError):
        raise ValueError("a matrix without flags, dimensions and name") from None
    text = bytes(name.content).decode("ascii", "replace")
    if wanted is not None and text != wanted:
        return text, None
    kind = _number(flags, order)
    shape = tuple(_numbers(sides, order).tolist())
    if depth > MOST_DEPTH or not all(side >= 0 for side in shape):
        raise ValueError("a matrix without a shape, or too deep")
    if kind & 0xFF in CLASSES:
        return text, _array(parts, kind, shape, order)
    if kind & 0xFF == CELL:
        return text, Cells(tuple(_part(part, order, depth) for part in _first(parts, math.prod(shape))))
    if kind & 0xFF == STRUCT:
        return text, _structs(parts, math.prod(shape), order, depth)
    return text, None


def _array(parts: Iterator[Element], kind: int, shape: tuple[int, ...], order: str) -> np.ndarray:
    values = _numbers(_first(parts, 1)[0], order)
    if kind & COMPLEX:
        values = values + 1j * _numbers(_first(parts, 1)[0], order)
    else:
        values = values.astype(CLASSES[kind & 0xFF], copy=False)
    if math.prod(shape) != len(values):
        raise ValueError(f"an array of {len(values)} numbers has the shape {shape}")
    return values.reshape(shape, order="F")


def _structs(parts: Iterator[Element], count: int, order: str, depth: int) -> Structs:
    length, names = _first(parts, 2)
    size = _number(length, order)
    if size < 1:
        raise ValueError("a struct whose fields have no names")
    texts = [bytes(names.content[k : k + size]) for k in range(0, len(names.content), size)]
    fields = [text.partition(b"\0")[0].decode("ascii", "replace") for text in texts]
    if not fields:
        return Structs(())
    values = iter([_part(part, order, depth) for part in _first(parts, count * len(fields))])
    return Structs(tuple(dict(zip(fields, row, strict=True)) for row in zip(*[values] * len(fields), strict=True)))


def _first(parts: Iterator[Element], count: int) -> list[Element]:
    found = list(itertools.islice(parts, count))
    if len(found) < count:
        raise ValueError("a matrix ends early")
    return found


def _part(element: Element, order: str, depth: int) -> Any:
    """A cell, or the field of a struct; an empty one has no content at all."""
    if element.kind != MATRIX:
        raise ValueError(f"an element of type {element.kind} where a matrix should be")
    return _matrix(element.content, order, depth=depth + 1)[1] if len(element.content) else np.zeros((0, 0))


def _number(element: Element, order: str) -> int:
    if len(element.content) < 4:
        raise ValueError("an element without the number that it should hold")
    return int(struct.unpack_from(f"{order}I", element.content)[0])


def _numbers(element: Element, order: str) -> np.ndarray:
    if element.kind not in NUMBERS:
        raise ValueError(f"an element of type {element.kind} where numbers should be")
    dtype = np.dtype(order + NUMBERS[element.kind])
    values = np.frombuffer(element.content, dtype, len(element.content) // dtype.itemsize)
    return values.astype(dtype.newbyteorder("="), copy=False)
