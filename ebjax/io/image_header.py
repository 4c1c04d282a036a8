"""What a picture's header says before a pixel is decoded: JPEG, PNG, TIFF, WebP and GIF."""

from dataclasses import dataclass, field
from io import BufferedIOBase
from pathlib import Path

from ebjax.io.exif import Exif, read_exif, tags

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
TIFFS = (b"II*\0", b"MM\0*")
FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
SCAN, APP1 = 0xDA, 0xE1
ALONE = frozenset({0x01, *range(0xD0, 0xD9)})
WIDTH, HEIGHT, BITS, EXTRA_SAMPLES, SAMPLE_FORMAT, DNG = 256, 257, 258, 338, 339, 50706
FLOAT = 3
FIRST_TAGS = 1 << 20
LONGEST = 1 << 20
"""Of a PNG's chunk that is read, bytes; EXIF has 64 kB at most."""


@dataclass(frozen=True)
class Header:
    """What a header says.

    Attributes:
      width: px, as stored.
      height: px, as stored.
      bits: of one channel.
      exif: orientation and time.
      alpha: whether there is a channel of it, or a transparent colour.
      animated: whether there is more than one picture.
      floats: whether the pixels are floating-point numbers.
      raw: whether it is a sensor's raw picture (DNG).
    """

    width: int
    height: int
    bits: int = 8
    exif: Exif = field(default_factory=Exif)
    alpha: bool = False
    animated: bool = False
    floats: bool = False
    raw: bool = False

    @property
    def size(self) -> tuple[int, int]:
        """Width and height as stored, px."""
        return self.width, self.height

    @property
    def turned_size(self) -> tuple[int, int]:
        """Width and height when turned as EXIF asks, px."""
        return (self.height, self.width) if self.exif.sideways else self.size


def read_header(path: Path) -> Header | None:
    """Reads a file's header; None where it is another format, damaged, or cannot be read."""
    try:
        with path.open("rb") as file:
            return header_of(file)
    except OSError:
        return None


def header_of(file: BufferedIOBase) -> Header | None:
    """Reads the header of an open file or of bytes in memory; None where it is another format, or damaged."""
    start = file.read(12)
    file.seek(0)
    if start[:8] == PNG_SIGNATURE:
        return _png(file)
    if start[:3] == b"\xff\xd8\xff":
        return _jpeg(file)
    if start[:4] in TIFFS:
        return _tiff(file.read(FIRST_TAGS), file)
    if start[:4] == b"RIFF" and start[8:] == b"WEBP":
        return _webp(file)
    if start[:6] in (b"GIF87a", b"GIF89a"):
        return _gif(file)
    return None


def _png(file: BufferedIOBase) -> Header | None:
    """Reads chunks until the pixels; EXIF may come behind them."""
    file.seek(8)
    found: dict[bytes, bytes] = {}
    pixels = False
    while len(head := file.read(8)) == 8 and head[4:] != b"IEND":
        size, kind = int.from_bytes(head[:4], "big"), head[4:]
        pixels |= kind == b"IDAT"
        if kind in (b"IHDR", b"eXIf", b"tRNS", b"acTL") and size <= LONGEST:
            found[kind] = file.read(size)
            file.seek(4, 1)
        else:
            file.seek(size + 4, 1)
    first = found.get(b"IHDR", b"")
    if len(first) != 13 or not pixels:
        return None
    return Header(
        int.from_bytes(first[:4], "big"),
        int.from_bytes(first[4:8], "big"),
        first[8],
        read_exif(found.get(b"eXIf", b"")),
        alpha=first[9] in (4, 6) or b"tRNS" in found,
        animated=int.from_bytes(found.get(b"acTL", b"")[:4], "big") > 1,
    )


def _jpeg(file: BufferedIOBase) -> Header | None:
    """Reads segments until the frame's; EXIF lies before it."""
    file.seek(2)
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
            return Header(width, height, content[0], exif) if len(content) == 5 and width and height else None
        if marker == APP1:
            content = file.read(size)
            if content[:6] == b"Exif\0\0":
                exif = read_exif(content[6:])
        else:
            file.seek(size, 1)
    return None


def _tiff(content: bytes, file: BufferedIOBase) -> Header | None:
    """Reads the first folder of tags, which may lie behind the pixels."""
    if int.from_bytes(content[4:8], "little" if content[:2] == b"II" else "big") >= len(content) - 2:
        content += file.read()
    found, exif = tags(content), read_exif(content)
    width, height, bits = found.get(WIDTH), found.get(HEIGHT), found.get(BITS, 1)
    if not (isinstance(width, int) and isinstance(height, int) and isinstance(bits, int)):
        return None
    return Header(
        width,
        height,
        bits,
        exif,
        alpha=EXTRA_SAMPLES in found,
        floats=found.get(SAMPLE_FORMAT) == FLOAT,
        raw=DNG in found,
    )


def _webp(file: BufferedIOBase) -> Header | None:
    """Reads the first chunk, and EXIF where the first says that it is there."""
    file.seek(12)
    kind, size = file.read(4), int.from_bytes(file.read(4), "little")
    start = file.read(10)
    if len(start) < 10:
        return None
    if kind == b"VP8 ":
        width, height = (int.from_bytes(start[at : at + 2], "little") & 0x3FFF for at in (6, 8))
        return Header(width, height)
    if kind == b"VP8L":
        packed = int.from_bytes(start[1:5], "little")
        return Header(1 + (packed & 0x3FFF), 1 + (packed >> 14 & 0x3FFF), alpha=bool(packed >> 28 & 1))
    if kind != b"VP8X":
        return None
    width, height = (1 + int.from_bytes(start[at : at + 3], "little") for at in (4, 7))
    flags, exif = start[0], Exif()
    file.seek(20 + size + size % 2)
    while flags & 8 and len(head := file.read(8)) == 8:
        size = int.from_bytes(head[4:], "little")
        if head[:4] == b"EXIF":
            exif = read_exif(file.read(size).removeprefix(b"Exif\0\0"))
            break
        file.seek(size + size % 2, 1)
    return Header(width, height, exif=exif, alpha=bool(flags & 16), animated=bool(flags & 2))


def _gif(file: BufferedIOBase) -> Header | None:
    """Walks over the blocks until a second picture."""
    screen = file.read(13)
    if len(screen) < 13:
        return None
    file.seek(_colours(screen[10]), 1)
    pictures = 0
    while pictures < 2 and (kind := file.read(1)) in (b",", b"!"):
        if kind == b",":
            pictures += 1
            if len(place := file.read(9)) < 9:
                return None
            file.seek(_colours(place[8]) + 1, 1)
        else:
            file.seek(1, 1)
        while (length := file.read(1)) and length != b"\0":
            file.seek(length[0], 1)
    if not pictures:
        return None
    width, height = int.from_bytes(screen[6:8], "little"), int.from_bytes(screen[8:10], "little")
    return Header(width, height, animated=pictures > 1)


def _colours(flags: int) -> int:
    """Bytes of a GIF's colour table."""
    return 3 << ((flags & 7) + 1) if flags & 0x80 else 0
