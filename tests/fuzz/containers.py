"""Mutations inside what wraps bytes, so that checksums and sizes stay right: gzip, zip, PNG, safetensors, SQLite."""

import gzip
import io
import random
import sqlite3
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable

import cv2
import numpy as np

from ebjax.io.opencv_log import quiet

PNG = b"\x89PNG\r\n\x1a\n"
SQLITE = b"SQLite format 3\0"
LONGEST = 1 << 20
SIDES = (0, 1, 7, 100, 20_000, 2**20, 2**31 - 1, 2**31)
BROKEN = (OSError, EOFError, ValueError, OverflowError, RuntimeError, zlib.error, struct.error, sqlite3.Error)
BROKEN = (*BROKEN, zipfile.BadZipFile)
"""What the libraries raise where a container is damaged already."""
Inner = Callable[[bytes], bytes]
CELLS = (None, -1, 0, 2**63 - 1, -(2**63), 1.5, 1e308, float("inf"), "text", "0.0.0", "1" * 500, b"", b"\0" * 48)


def change_gzip(content: bytes, draw: random.Random, inner: Inner) -> bytes:
    """Mutates what is packed."""
    with gzip.GzipFile(fileobj=io.BytesIO(content)) as file:
        return gzip.compress(inner(file.read(LONGEST)), mtime=0)


def change_zip(content: bytes, draw: random.Random, inner: Inner) -> bytes:
    """Mutates, removes, renames or compresses a member of a zip file."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    packed = zipfile.ZIP_STORED
    if members:
        name = draw.choice(sorted(members))
        how = draw.randrange(8)
        if how == 0:
            del members[name]
        elif how == 1:
            members[draw.choice((f"{name}x", "archive/byteorder", "archive/data/9", "x"))] = members.pop(name)
        elif how == 2:
            packed = zipfile.ZIP_DEFLATED
        else:
            members[name] = inner(members[name])
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", packed) as archive:
        for name, member in members.items():
            archive.writestr(zipfile.ZipInfo(name), member, packed)
    return out.getvalue()


def change_png(content: bytes, draw: random.Random, inner: Inner) -> bytes:
    """Mutates the content of a PNG's chunk, its header's numbers above all, and corrects the checksum."""
    chunks, position = list[tuple[bytes, bytes]](), len(PNG)
    while position + 12 <= len(content) and len(chunks) < 1000:
        (size,) = struct.unpack_from(">I", content, position)
        chunks.append((content[position + 4 : position + 8], content[position + 8 : position + 8 + size]))
        position += 12 + size
    if not chunks:
        return inner(content)
    place = 0 if draw.random() < 0.5 else draw.randrange(len(chunks))
    kind, data = chunks[place]
    if kind == b"IHDR" and len(data) == 13:
        sides = [draw.choice((*SIDES, side)) for side in struct.unpack(">2I", data[:8])]
        bits, colour, interlaced = draw.choice((1, 8, 16, data[8])), draw.choice((0, 2, 3, 4, 6)), draw.choice((0, 1))
        data = draw.choice((struct.pack(">2I", *sides) + data[8:], data[:8] + bytes([bits, colour, 0, 0, interlaced])))
    elif draw.random() < 0.5:
        data = zlib.compress(draw.randbytes(draw.choice((1, 4000))))
    else:
        data = inner(data)[:LONGEST]
    chunks[place] = kind, data
    parts = [struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in chunks]
    return PNG + b"".join(parts)


def change_safetensors(content: bytes, draw: random.Random, inner: Inner) -> bytes:
    """Mutates the JSON in front of the numbers."""
    (size,) = struct.unpack_from("<Q", content)
    head = inner(content[8 : 8 + size])
    return struct.pack("<Q", len(head)) + head + content[8 + size :]


def change_sqlite(content: bytes, draw: random.Random, inner: Inner) -> bytes:
    """Drops a table, renames or drops a column, empties a table, or sets a cell anew."""
    base = sqlite3.connect(":memory:")
    try:
        base.deserialize(content)
        tables = [name for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name")]
        table = draw.choice(tables)
        columns = [row[1] for row in base.execute(f"PRAGMA table_info({table})")]
        column, how = draw.choice(columns), draw.randrange(12)
        if how == 0:
            base.execute(f"DROP TABLE {table}")
        elif how == 1:
            base.execute(f"ALTER TABLE {table} RENAME COLUMN {column} TO {column}_other")
        elif how == 2:
            base.execute(f"ALTER TABLE {table} DROP COLUMN {column}")
        elif how == 3:
            base.execute(f"DELETE FROM {table}")
        elif how == 4:
            base.execute(f"CREATE TABLE spare AS SELECT * FROM {table}")
            base.execute(f"DROP TABLE {table}")
            base.execute(f"ALTER TABLE spare RENAME TO {table}")
            base.execute(f"INSERT INTO {table} SELECT * FROM {table}")
        else:
            rows = [row for (row,) in base.execute(f"SELECT rowid FROM {table}")]
            row = draw.choice(rows) if rows else 0
            (cell,) = base.execute(f"SELECT {column} FROM {table} WHERE rowid = ?", (row,)).fetchone() or (None,)
            if isinstance(cell, bytes) and cell and draw.random() < 0.8:
                value = inner(cell)
            else:
                value = draw.choice((*CELLS, cell))
            every = " OR 1" * (draw.random() < 0.2)
            base.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = ?{every}", (value, row))
        base.commit()
        return base.serialize()
    finally:
        base.close()


def change_image(content: bytes, draw: random.Random, inner: Inner) -> bytes:
    """A whole picture of another format, size, depth or number of channels."""
    height, width, channels = draw.choice((1, 7, 24, 48)), draw.choice((1, 8, 32, 64)), draw.choice((1, 3, 4))
    kind = draw.choice((np.uint8, np.uint8, np.uint16, np.int16, np.float32, np.float64))
    image = np.full((height, width, channels), draw.choice((0, 1, 200)), kind)
    if kind in (np.float32, np.float64):
        image[0, 0] = draw.choice((np.nan, np.inf, -1.0, 1e30))
    suffix = draw.choice((".png", ".jpg", ".bmp", ".tiff", ".webp", ".pbm", ".ppm", ".pfm", ".hdr", ".gif"))
    with quiet():
        done, written = cv2.imencode(suffix, image)
    return written.tobytes() if done else content


CONTAINERS = (
    (b"\x1f\x8b", change_gzip),
    (b"PK\x03\x04", change_zip),
    (PNG, change_png),
    (PNG, change_image),
    (b"\xff\xd8", change_image),
    (SQLITE, change_sqlite),
)


def change_inside(content: bytes, draw: random.Random, inner: Inner) -> bytes:
    """Mutates inside a container; what is none, or is damaged already, is mutated as it is."""
    ways = [way for start, way in CONTAINERS if content.startswith(start)]
    if content[8:9] == b"{":
        ways = [change_safetensors]
    if not ways:
        return inner(content)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return draw.choice(ways)(content, draw, inner)
    except BROKEN:
        return inner(content)
