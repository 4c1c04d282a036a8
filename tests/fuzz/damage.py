"""Mutations of bytes and of text; each takes content and a random generator, and gives other content.

What is packed in gzip, zip, PNG, safetensors or SQLite is mutated by `containers`, JSON and YAML by `trees`.
"""

import random
import struct
from collections.abc import Callable

import numpy as np

NUMBERS = (
    *"0 -1 -0.0 1 2147483648 9223372036854775808 18446744073709551616 1e308 -1e308 1e-320 nan inf -inf NaN 1_0".split(),
    *("9" * 400, "1e999", "٣", "", "1.2.3", "0x10", "true", "null"),
)
COUNTS = (0, 1, 2, 127, 128, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1)
LINES = (
    *("", "#", "---", "\x00", "\x85", "\u2028x"),
    *("a" * 100_000, "1 " * 20_000, "[" * 5_000, "{" * 5_000, "- " * 2_000),
)
SEPARATORS = (" ", ",", ";", "\t", "  ", "\xa0", "")

Mutation = Callable[[bytes, random.Random], bytes]


def _span(content: bytes, draw: random.Random, longest: int = 64) -> tuple[int, int]:
    start = draw.randrange(len(content) + 1)
    return start, min(start + draw.randint(1, longest), len(content))


def flip(content: bytes, draw: random.Random) -> bytes:
    """Sets up to 8 bytes, or single bits, anew."""
    changed = bytearray(content)
    for _ in range(draw.choice((1, 1, 2, 8))):
        if changed:
            place = draw.randrange(len(changed))
            changed[place] = draw.choice((changed[place] ^ 1 << draw.randrange(8), draw.randrange(256), 0, 255))
    return bytes(changed)


def flip_early(content: bytes, draw: random.Random) -> bytes:
    """Changes the first 64 bytes, where most formats keep their counts."""
    return flip(content[:64], draw) + content[64:]


def truncate(content: bytes, draw: random.Random) -> bytes:
    """Keeps the beginning, sometimes all but a few bytes."""
    return content[: draw.choice((draw.randrange(len(content) + 1), max(len(content) - draw.randint(1, 16), 0)))]


def behead(content: bytes, draw: random.Random) -> bytes:
    """Keeps the end."""
    return content[draw.randrange(len(content) + 1) :]


def insert(content: bytes, draw: random.Random) -> bytes:
    """Puts in random bytes, or many equal ones."""
    place = draw.randrange(len(content) + 1)
    more = draw.choice((draw.randbytes(draw.randint(1, 16)), bytes([draw.randrange(256)]) * draw.choice((1, 64, 5000))))
    return content[:place] + more + content[place:]


def duplicate(content: bytes, draw: random.Random) -> bytes:
    """Repeats a block, where it is or elsewhere."""
    start, end = _span(content, draw, 512)
    place = draw.choice((end, draw.randrange(len(content) + 1)))
    return content[:place] + content[start:end] * draw.choice((1, 1, 3)) + content[place:]


def delete(content: bytes, draw: random.Random) -> bytes:
    """Takes a block out."""
    start, end = _span(content, draw, draw.choice((1, 4, 64, 4096)))
    return content[:start] + content[end:]


def set_count(content: bytes, draw: random.Random) -> bytes:
    """Writes an edge of the integers over 1 to 8 bytes, in either byte order: many of these bytes are lengths."""
    size, order = draw.choice((1, 2, 4, 4, 8, 8)), draw.choice(("little", "big"))
    value = draw.choice((draw.choice(COUNTS), draw.randrange(70_000))) % 256**size
    place = draw.randrange(max(len(content) - size, 0) + 1)
    if draw.random() < 0.5:
        place -= place % 4
    return content[:place] + value.to_bytes(size, order) + content[place + size :]


def change_length(content: bytes, draw: random.Random) -> bytes:
    """Changes a whole number of 4 bytes that may well be a length: small, and not zero."""
    order = draw.choice(("<u4", ">u4"))
    start = draw.randrange(len(content) + 1)
    for begin in (start, 0):
        numbers = np.frombuffer(content, order, max(len(content) - begin, 0) // 4, begin)
        places = np.flatnonzero((numbers > 0) & (numbers < max(len(content), 300)))[:64]
        if len(places):
            place = begin + 4 * int(draw.choice(places.tolist()))
            was = int.from_bytes(content[place : place + 4], "little" if order == "<u4" else "big")
            value = draw.choice(
                (was + 1, was - 1, 2 * was, was * 4, was << 16, draw.choice(COUNTS), draw.randrange(300))
            )
            return content[:place] + np.array(value % 2**32, order).tobytes() + content[place + 4 :]
    return content


def set_float(content: bytes, draw: random.Random) -> bytes:
    """Writes a float of either size over aligned bytes."""
    kind = draw.choice(("<f", "<d", ">f", ">d"))
    value = struct.pack(kind, draw.choice((float("nan"), float("inf"), -1.0, 0.0, 3e38, 1e-38)))
    place = draw.randrange(len(content) + 1) // 4 * 4
    return content[:place] + value + content[place + len(value) :]


def empty(content: bytes, draw: random.Random) -> bytes:
    """Nothing, or blanks alone."""
    return draw.choice((b"", b"", b" \n\n", b"\0" * 100))


def garbage(content: bytes, draw: random.Random) -> bytes:
    """Random bytes, maybe behind the first ones of a format."""
    head = draw.choice((b"", content[:4], content[:16], b"\x1f\x8b\x08\0", b"\x28\xb5\x2f\xfd", b"PK\3\4"))
    return head + draw.randbytes(draw.choice((1, 100, 5000)))


def encode_otherwise(content: bytes, draw: random.Random) -> bytes:
    """Writes text in another encoding, with or without a mark, or with another end of line."""
    text = content.decode("utf-8", "replace")
    encodings = ("utf-8-sig", "utf-16", "utf-16-le", "utf-32", "latin-1", "cp037")
    return draw.choice(
        (text.encode(draw.choice(encodings), "replace"), content.replace(b"\n", draw.choice((b"\r\n", b"\r"))))
    )


def change_number(content: bytes, draw: random.Random) -> bytes:
    """Writes another number, or none, in the place of one in a text."""
    return _change_field(
        content, draw, lambda field: any(c.isdigit() for c in field), lambda field: draw.choice(NUMBERS)
    )


def change_word(content: bytes, draw: random.Random) -> bytes:
    """Doubles a word of a text, cuts it, or changes a letter."""

    def changed(field: str) -> str:
        place = draw.randrange(len(field))
        letter = draw.choice(("\0", "é", "\ufeff", "\x1b", "'", '"', ":", "&a", "*a", "!!python/object:os.system "))
        return draw.choice((field * 2, field[:place], field[:place] + letter + field[place + 1 :], field.swapcase()))

    return _change_field(content, draw, lambda field: True, changed)


def _change_field(
    content: bytes, draw: random.Random, chosen: Callable[[str], bool], change: Callable[[str], str]
) -> bytes:
    lines = content.decode("latin-1").split("\n")
    number = draw.randrange(len(lines))
    fields = lines[number].split(" ")
    places = [place for place, field in enumerate(fields) if field and chosen(field)]
    if not places:
        return content
    place = draw.choice(places)
    fields[place] = change(fields[place]).encode("utf-8", "replace").decode("latin-1")
    lines[number] = draw.choice((" ", " ", " ", *SEPARATORS)).join(fields)
    return "\n".join(lines).encode("latin-1")


def change_lines(content: bytes, draw: random.Random) -> bytes:
    """Shuffles, repeats, deletes, swaps or joins lines, or puts in a strange one."""
    lines = content.split(b"\n")
    place, other = draw.randrange(len(lines)), draw.randrange(len(lines))
    how = draw.randrange(6)
    if how == 0:
        draw.shuffle(lines)
    elif how == 1:
        lines.insert(other, lines[place])
    elif how == 2:
        del lines[place]
    elif how == 3:
        lines[place], lines[other] = lines[other], lines[place]
    elif how == 4:
        lines[place : place + 2] = [b" ".join(lines[place : place + 2])]
    else:
        lines.insert(place, draw.choice(LINES).encode("utf-8", "replace"))
    return b"\n".join(lines)


def nest(content: bytes, draw: random.Random) -> bytes:
    """Puts a text into hundreds or thousands of brackets, tags or indents, or behind blank lines."""
    mark = draw.choice((b"[", b"{", b"<a>", b"- ", b"{a: ", b'{"a":', b"(", b"\n", b" ", b"\t"))
    head, _, tail = content.partition(b"\n")
    return draw.choice((b"", head + b"\n")) + mark * draw.choice((99, 300, 3000, 30_000)) + tail


BYTES: tuple[Mutation, ...] = (
    *(flip, flip, flip_early, truncate, behead, insert, duplicate, delete, set_count, change_length, change_length),
    *(set_float, empty, garbage),
)
TEXT: tuple[Mutation, ...] = (
    *(change_number, change_number, change_number, change_word, change_word, change_lines, change_lines),
    *(encode_otherwise, nest),
)


def is_text(content: bytes) -> bool:
    """Whether content is text."""
    try:
        return "\0" not in content[:4096].decode("utf-8")
    except UnicodeDecodeError:
        return False


def splice(content: bytes, other: bytes, draw: random.Random) -> bytes:
    """The beginning of one and the end of another, or one inside the other."""
    start, end = draw.randrange(len(content) + 1), draw.randrange(len(other) + 1)
    return content[:start] + other[end:] + draw.choice((b"", content[start:]))
