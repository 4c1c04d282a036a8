"""A picture's size, EXIF and bits, read from its header alone: JPEG and PNG."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from ebjax.io.images import PNG_SIGNATURE
from ebjax.io.logs.exif import Exif, read_exif

FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
SCAN, APP1 = 0xDA, 0xE1
ALONE = frozenset({0x01, *range(0xD0, 0xD9)})


@dataclass(frozen=True)
class Header:
    """Size of the picture as it is decoded, after EXIF's turn; bits of one channel."""

    width: int
    height: int
    bits: int = 8
    exif: Exif = field(default_factory=Exif)


def read_header(path: Path) -> Header | None:
    """Reads the header of a JPEG or PNG; None where it is another format, damaged, or cannot be read."""
    try:
        with path.open("rb") as file:
            start = file.read(8)
            if start == PNG_SIGNATURE:
                return _png(file)
            if start[:3] == b"\xff\xd8\xff":
                file.seek(2)
                return _jpeg(file)
    except OSError:
        return None
    return None


def _png(file: BinaryIO) -> Header | None:
    """Reads chunks until the pixels; None with EXIF, which not every OpenCV obeys in a PNG."""
    header = None
    while len(head := file.read(8)) == 8 and head[4:] not in (b"IDAT", b"IEND", b"eXIf"):
        size = int.from_bytes(head[:4], "big")
        if head[4:] == b"IHDR":
            content = file.read(size)
            if len(content) != 13:
                return None
            header = Header(int.from_bytes(content[:4], "big"), int.from_bytes(content[4:8], "big"), content[8])
            file.seek(4, 1)
        else:
            file.seek(size + 4, 1)
    return header if head[4:] == b"IDAT" else None


def _jpeg(file: BinaryIO) -> Header | None:
    """Reads segments until the frame's; EXIF lies before it."""
    exif = Exif()
    while (start := file.read(2)) and start[:1] == b"\xff" and len(start) == 2:
        marker = start[1]
        if marker == 0xFF:
            file.seek(-1, 1)
            continue
        if marker in ALONE:
            continue
        size = int.from_bytes(file.read(2), "big") - 2
        if marker == SCAN or size < 0:
            return None
        if marker in FRAMES:
            content = file.read(5)
            height, width = int.from_bytes(content[1:3], "big"), int.from_bytes(content[3:5], "big")
            if len(content) < 5 or not width or not height:
                return None
            return Header(*((height, width) if exif.sideways else (width, height)), content[0], exif)
        if marker == APP1:
            content = file.read(size)
            if content[:6] == b"Exif\0\0":
                exif = read_exif(content[6:])
        else:
            file.seek(size, 1)
    return None
