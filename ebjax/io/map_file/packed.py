"""Named arrays in one blob: the length of a JSON header as uint32, the header, the arrays' bytes.

The header lists [name, dtype, shape, stored bytes, deflated] for each array. Arrays are little-endian, in C order, one
after the other, each from a multiple of 16 bytes of the blob on. Masks are deflated, since they shrink to a hundredth;
descriptors, images and points do not shrink.
"""

import json
import math
import struct
import zlib
from collections.abc import Mapping

import numpy as np

ALIGNMENT = 16
KINDS = "biufcSU"
LEVEL = 1


def pack(arrays: Mapping[str, np.ndarray]) -> bytes:
    """Packs arrays, bit for bit.

    Raises:
      ValueError: an array of objects or of a type that NumPy alone does not know; names it.
    """
    entries, parts = [], list[bytes]()
    for name, value in arrays.items():
        array = np.asarray(value)
        if array.dtype.kind not in KINDS:
            raise ValueError(f"array {name!r} is of type {array.dtype}; convert it to one of NumPy's plain types")
        kind = array.dtype.newbyteorder("<")
        content = array.astype(kind, copy=False).tobytes()
        deflated = zlib.compress(content, LEVEL) if array.dtype.kind == "b" else content
        smaller = len(deflated) < len(content)
        parts.append(deflated if smaller else content)
        entries.append((name, kind.str, array.shape, len(parts[-1]), smaller))
    header = json.dumps(entries).encode()
    blob = bytearray(struct.pack("<I", len(header)) + header)
    for part in parts:
        blob += bytes(-len(blob) % ALIGNMENT) + part
    return bytes(blob)


def unpack(blob: bytes) -> dict[str, np.ndarray]:
    """Unpacks what `pack` packed; arrays are read-only and share the blob's memory where they are not deflated.

    Raises:
      ValueError: not a blob of `pack`.
    """
    try:
        (length,) = struct.unpack_from("<I", blob)
        arrays, start = {}, 4 + length
        for name, dtype, shape, stored, deflated in json.loads(blob[4:start]):
            start += -start % ALIGNMENT
            arrays[name] = _array(blob, np.dtype(dtype), shape, start, stored if deflated else None)
            start += stored
        return arrays
    except (struct.error, TypeError, KeyError, UnicodeDecodeError, zlib.error, ValueError, RecursionError):
        raise ValueError("not arrays as a map packs them") from None


def _array(blob: bytes, kind: np.dtype, shape: list[int], start: int, deflated: int | None) -> np.ndarray:
    if kind.kind not in KINDS:
        raise ValueError(kind)
    count = math.prod(shape)
    if deflated is None:
        return np.frombuffer(blob, kind, count, start).reshape(shape)
    engine = zlib.decompressobj()
    content = engine.decompress(blob[start : start + deflated], count * kind.itemsize + 1)
    if not engine.eof:
        raise ValueError("cut off")
    return np.frombuffer(content, kind).reshape(shape)
